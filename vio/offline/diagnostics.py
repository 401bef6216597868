"""What a run's own counts say against it: a warning a line, with its cause where it is known."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from vio.errors import LogError
from vio.filter import eskf as flt
from vio.filter.eskf import ErrorStateFilter
from vio.localize.localizer import Localizer
from vio.localize.run import RunResult
from vio.setup_check.unmapped_tags import other_family
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

if TYPE_CHECKING:
    from tagvo.pipeline import Trace

_FIT_TAGS, _FIT_FRAMES = 4, 20  # fewer tags can be explained by a pose that is wrong
# chi-square; medians of 10 healthy real and simulated logs 0.3 to 12, of wrong focal lengths
# (by 20 %), lenses and resolutions 26 to 140
_MISFIT_CHI2 = 18.0
REJECTED = (*flt.REFUSED, "pose_not_finite")


class CornerFit:
    """Gathers how well joint poses explain the corners: a file of another lens cannot."""

    def __init__(self) -> None:
        self._chi2: list[float] = []

    def look(self, trace: "Trace") -> None:
        """Take a frame's median chi-square of a tag (8 residuals), where enough tags are seen."""
        if trace.joint is not None and len(trace.joint.chi2) >= _FIT_TAGS:
            self._chi2.append(float(np.median(trace.joint.chi2)))

    def words(self, source: str) -> list[str]:
        """A line where most frames do not fit; source: the camera's file."""
        if len(self._chi2) < _FIT_FRAMES or np.median(self._chi2) < _MISFIT_CHI2:
            return []
        sigmas = float(np.sqrt(np.median(self._chi2) / 8.0))
        bad = int(np.sum(np.array(self._chi2) > _MISFIT_CHI2))
        return [
            f"{source}: in {bad} of {len(self._chi2)} frames with {_FIT_TAGS} tags and more the"
            f" corners lie off the best pose by {sigmas:.1f} sigma and more: intrinsics or lens"
            " distortion are not this camera's, or the map's tags lie elsewhere"
        ]


def run_warnings(
    log: FlightLog, result: RunResult, vio: Localizer | None, fit: CornerFit, codes: set[str],
    *, all_tags: bool,
) -> list[str]:  # fmt: skip
    """All that a run says against itself.

    codes: of the set-up's findings; all_tags: none of the map was left out.
    """
    said = [] if vio is None else filter_doubts(vio, log, result, explained=bool(codes))
    said += [] if "size_kind" in codes else fit.words(log.camera.source)
    return [*said, *(strange_tags(log, result) if all_tags else [])]


def stopped(log: FlightLog, result: RunResult, *, early: bool) -> list[str]:
    """How far a run came that did not reach the end of its log (early), and what stopped it."""
    if not (result.interrupted or early) or result.reached_ns is None:
        return []
    done_s, whole_s = (1e-9 * (t_ns - log.t0_ns) for t_ns in (result.reached_ns, log.end_ns))
    if result.interrupted:
        return [f"stopped by Ctrl-C after {done_s:.1f} of {whole_s:.1f} s"]
    return [f"stopped at {done_s:.1f} of {whole_s:.1f} s: the set-up is wrong"]


_TRIED_IMAGES = 5  # of a log without any tag: one look with each other family


def strange_tags(log: FlightLog, result: RunResult) -> list[str]:
    """Tags that the map does not know, and the family that it should have named."""
    said = result.unmapped.words(log.tag_map, result.with_pose)
    if result.frames and not result.unmapped.found and not result.interrupted:
        rows = range(0, log.frame_count, max(1, log.frame_count // _TRIED_IMAGES))
        again = replace(log.frames, tally=Tally())  # what it cannot read is counted already
        frames = (again.frame(row) for row in rows[:_TRIED_IMAGES])
        family = log.tag_map.family.name
        other = other_family((f.image for f in frames if f is not None), family)
        if other is not None:  # nothing in the results is of use
            raise LogError(f"{log.path}: {other}")
    return [f"{log.path}: {text}" for text in said]


_LEAST_TRACKING = 0.9  # while frames give poses; 14 healthy logs: 1.000, wrong set-ups 0 to 0.97
_MOST_RESTARTS = 1  # the healthy ones: 0, wrong scale, focal length, lens or sign: 2 to 63
_A_RESTART_S = 60.0  # more rarely, they may be faults of hours of flight


def filter_doubts(
    vio: Localizer, log: FlightLog, result: RunResult, *, explained: bool
) -> list[str]:
    """What the filter's own counts say against it: it never started, starts anew, or believes few.

    explained: whether the set-up check has named a mistake that may be the cause.
    """
    where = str(log.path)
    if not result.outputs["vio"]:
        why = ", ".join(_core(vio).health().reasons)
        return [f"{where}: the filter never started ({why}); vio.tum is empty"]
    noise = _core(vio).noise_words
    said = [] if noise is None else [f"{where}: {noise}"]
    signs = _bad_signs(vio, log, result)
    if not signs:
        return said
    cause = "the set-up check names a cause"
    if not explained:
        cause = (
            "IMU, camera and map contradict one another: are the IMU's units (rad/s, m/s^2), axes,"
            " signs and clock, T_cam_imu, the camera's intrinsics and the map's metres right?"
        )
    return [*said, f"{where}: the filter {'; it '.join(signs)}: vio is not to be trusted; {cause}"]


def _bad_signs(vio: Localizer, log: FlightLog, result: RunResult) -> list[str]:
    """What tells that a filter is no use, each as what it did."""
    signs = []
    restarts = _core(vio).counters.get("restarts", 0)
    seconds = 1e-9 * ((result.reached_ns or log.t0_ns) - log.t0_ns)
    if restarts > _MOST_RESTARTS and restarts * _A_RESTART_S > seconds:
        signs.append(f"started anew {restarts} times in {seconds:.0f} s")
    seeing = sum(vio.seeing.values())
    share = vio.seeing["TRACKING"] / max(seeing, 1)
    if seeing and share < _LEAST_TRACKING:
        why = ", ".join(f"{name} in {n}" for name, n in vio.doubts.most_common(3))
        signs.append(
            f"was TRACKING in {100.0 * share:.0f} % of the {seeing} samples while frames gave poses"
            + (f" ({why})" if why else "")
        )
    bad = sum(vio.states[state] for state in ("LOST", "RELOCATING"))
    if bad > 0.5 * sum(vio.states.values()):
        why = ", ".join(f"{name} in {n}" for name, n in vio.doubts.most_common(3))
        signs.append(
            f"was LOST or RELOCATING in {bad} of {sum(vio.states.values())} samples ({why})"
        )
    fused, rejected = verdicts(vio, flt.TAKEN), verdicts(vio, REJECTED)
    if 2 * rejected > fused:
        signs.append(f"rejected {rejected} poses and took {fused}")
    return signs


def _core(vio: Localizer) -> ErrorStateFilter:
    assert vio.filter is not None, "it is asked about its filter"
    return vio.filter


def verdicts(vio: Localizer, names: tuple[str, ...]) -> int:
    """How many poses met one of these fates."""
    counters = _core(vio).counters
    return sum(counters.get(name, 0) for name in names)
