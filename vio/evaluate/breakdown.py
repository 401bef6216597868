"""Where an estimator is good and where it is not: by phase, height, speed and number of tags.

Also its drift, its dominant axis, whether its covariance tells the truth, and how late it is.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tagvo.geometry import Array, BoolArray, IntArray
from vio.evaluate.compare import Judged
from vio.evaluate.metrics import nees, summary
from vio.evaluate.records import Errors, Window
from vio.evaluate.relative import pairs_along_way, pairs_in_time, relative_errors
from vio.evaluate.truth import TruthTrack, interpolate
from vio.records import Phase

Figures = dict[str, float | int | None]
_FEWEST = 5  # errors that a bin needs
_HEIGHTS_M = (0.0, 0.5, 1.0, 1.5, 2.0, np.inf)
_SPEEDS_M_S = (0.0, 0.1, 0.5, 1.0, 2.0, np.inf)
_TAGS = (0.0, 1.0, 2.0, 4.0, 8.0, 16.0, np.inf)
_DRIFT_S, _DRIFT_M = (1.0, 5.0), (1.0, 5.0)


def breakdown(
    judged: Sequence[Judged],
    truth: TruthTrack,
    phases: Sequence[Phase],
    window: Window,
    up_W: Array,
    tags: tuple[IntArray, IntArray] | None,
) -> dict[str, Any]:
    """The content of `evaluation.json`: for each estimator, its errors and what they depend on.

    up_W (3,): against gravity, for heights above the map's origin; tags: stamps and number of tags
    used in each frame.
    """
    out: dict[str, Any] = {}
    for one in judged:
        now = one.now
        at = interpolate(truth, now.t_ns)
        height, speed = at.p_WI @ up_W, np.linalg.norm(at.v_WI, axis=-1)
        by: dict[str, Any] = {
            "phase": by_phase(now, phases, window),
            "height_m": binned(now, height, _HEIGHTS_M),
            "speed_m_s": binned(now, speed, _SPEEDS_M_S),
        }
        if tags is not None and len(tags[0]):
            by["tags"] = binned(now, _held(tags, now.t_ns), _TAGS)
        out[one.trajectory.name] = {
            "by": by,
            "relative": drift(one, truth, window),
            "axes": axes(now),
            "consistency": consistency(one.capture),
            "age_ms": age(one, window),
        }
    return out


def by_phase(errors: Errors, phases: Sequence[Phase], window: Window) -> dict[str, Figures]:
    """Figures of each phase's name; phases of one name are taken together."""
    out = {}
    for name in dict.fromkeys(p.name for p in phases):
        inside = np.zeros(len(errors), dtype=bool)
        for p in phases:
            if p.name == name:
                inside |= (errors.t_ns >= p.t_start_ns) & (errors.t_ns < p.t_end_ns)
        if inside.any():
            out[name] = figures(errors, inside & window.holds(errors.t_ns))
    return out


def binned(errors: Errors, x: Array, edges: Sequence[float]) -> dict[str, Figures]:
    """Figures of the errors in each bin of x (n,) that holds enough of them."""
    out = {}
    for low, high in pairwise(edges):
        inside = (x >= low) & (x < high)
        if inside.sum() >= _FEWEST:
            name = f"{low:g} and more" if np.isinf(high) else f"{low:g} to {high:g}"
            out[name] = figures(errors, inside)
    return out


def figures(errors: Errors, rows: BoolArray) -> Figures:
    """Position and rotation of some of the errors."""
    position = np.linalg.norm(errors.p_W[rows], axis=-1)
    rotation = np.degrees(np.linalg.norm(errors.rotation_I[rows], axis=-1))
    out: Figures = {f"position_{k}_m": v for k, v in summary(position, ("rmse", "max")).items()}
    out |= {f"rotation_{k}_deg": v for k, v in summary(rotation, ("rmse",)).items()}
    out["n"] = len(position)
    return out


def drift(one: Judged, truth: TruthTrack, window: Window) -> dict[str, Figures]:
    """Relative pose errors over times and ways, of the poses at capture in order of time."""
    track = one.trajectory
    order = np.argsort(track.t_ns, kind="stable")
    order = order[window.holds(track.t_ns[order])]
    at = interpolate(truth, track.t_ns[order])
    rows = order[at.known]
    p_WI, R_WI, t_ns = track.p_WI[rows], track.R_WI[rows], track.t_ns[rows]
    p_WI_true, R_WI_true = at.p_WI[at.known], at.R_WI[at.known]
    ways: list[tuple[str, Callable[[], IntArray]]] = [
        *((f"{s:g} s", lambda s=s: pairs_in_time(t_ns, s)) for s in _DRIFT_S),
        *((f"{m:g} m", lambda m=m: pairs_along_way(p_WI_true, m)) for m in _DRIFT_M),
    ]
    out: dict[str, Figures] = {}
    for name, find in ways:
        pairs = find() if len(rows) else np.zeros((0, 2), dtype=np.int64)
        if len(pairs):
            moved, turned = relative_errors(p_WI, R_WI, p_WI_true, R_WI_true, pairs)
            out[name] = {
                "position_rmse_m": float(np.sqrt(np.mean(moved**2))),
                "rotation_rmse_deg": float(np.degrees(np.sqrt(np.mean(turned**2)))),
                "n": len(pairs),
            }
    return out


def axes(errors: Errors) -> dict[str, float | str | None]:
    """Root mean square along each axis of W, and the direction in which most of it lies."""
    if not len(errors):
        return {}
    e = errors.p_W
    values, vectors = np.linalg.eigh(e.T @ e / len(e))
    main = vectors[:, -1] * np.sign(vectors[np.argmax(np.abs(vectors[:, -1])), -1])
    rms = np.sqrt(np.mean(e**2, axis=0))
    out: dict[str, float | str | None] = {f"{a}_rms_m": float(r)
                                          for a, r in zip("xyz", rms, strict=True)}  # fmt: skip
    out["main_direction"] = " ".join(f"{x:+.2f}" for x in main)
    out["main_share"] = float(values[-1] / max(values.sum(), 1e-30))
    return out


def consistency(errors: Errors) -> Figures:
    """How often the six errors' NEES lies where a true covariance has 95 % of them, two-sided."""
    from scipy.stats import chi2

    known = nees(errors)
    known = known[np.isfinite(known)]
    if not len(known):
        return {}
    low, high = chi2.ppf([0.025, 0.975], 6)
    return {
        "nees_mean": float(known.mean() / 6.0),
        "nees_median": float(np.median(known) / chi2.ppf(0.5, 6)),
        "below_95": float(np.mean(known < low)),
        "inside_95": float(np.mean((known >= low) & (known <= high))),
        "above_95": float(np.mean(known > high)),
        "n": len(known),
    }


def age(one: Judged, window: Window) -> Figures:
    """How long after its moment an output was known [ms]."""
    track = one.trajectory
    late = (track.known_ns - track.t_ns)[window.holds(track.t_ns)] * 1e-6
    if not len(late):
        return {}
    p50, p95, p99 = np.percentile(late, [50, 95, 99])
    return {"p50": float(p50), "p95": float(p95), "p99": float(p99), "n": len(late)}


def _held(tags: tuple[IntArray, IntArray], t_ns: IntArray) -> Array:
    """Number of tags of the last frame before each stamp; NaN before the first."""
    order = np.argsort(tags[0], kind="stable")
    last = np.searchsorted(tags[0][order], t_ns, side="right") - 1
    return np.where(last >= 0, tags[1][order][np.maximum(last, 0)].astype(float), np.nan)


def up_of(gravity_W: Sequence[float] | None) -> Array:
    """Against gravity where the map knows it, else along its z; (3,) unit."""
    down = np.array([0.0, 0.0, -1.0] if gravity_W is None else gravity_W, dtype=float)
    return np.asarray(-down / np.linalg.norm(down))
