"""Says the outcome of a comparison in one sentence, for people who read no further."""

from collections.abc import Mapping
from typing import Any

LABELS = {"vo": "VO", "vo_fir": "VO with FIR", "vo_kf": "VO with Kalman filter", "vio": "VIO"}
_RMS = "position_rmse_m"


def label(name: str) -> str:
    """How an estimator is called in tables and plots."""
    return LABELS.get(name, name)


def verdict(content: Mapping[str, Any]) -> str:
    """One sentence on the content of a `comparison.json`: who knows best, by how much."""
    known = {
        name: views
        for name, views in content["estimators"].items()
        if views["now"] is not None and views["now"][_RMS] is not None
    }
    if not known:
        return "No estimator gave a pose that can be compared with truth."
    ranked = sorted(known, key=lambda name: float(known[name]["now"][_RMS]))
    if len(ranked) == 1:
        return _alone(ranked[0], known[ranked[0]])
    best = ranked[0]
    other = "vo" if "vo" in known and best != "vo" else ranked[1]
    return _against(best, known[best], other, known[other])


def _alone(name: str, views: Mapping[str, Any]) -> str:
    if views["capture"] is None:
        return f"{label(name)} was off by {_rms(views['now'])} (rms) live; no pose met truth."
    at, now = views["capture"], views["now"]
    return (
        f"{label(name)} was off by {_rms(at)} (rms) at the moment of each image,"
        f" by {_rms(now)} live, and had a pose for {_percent(at['coverage'])} of truth."
    )


def _against(best: str, a: Mapping[str, Any], other: str, b: Mapping[str, Any]) -> str:
    text = (
        f"Live, {label(best)} was the best: off by {_rms(a['now'])} (rms)"
        f" against {_rms(b['now'])} for {label(other)}"
    )
    if a["capture"] is None or b["capture"] is None:
        return text + "."
    return (
        f"{text}; at the moment each pose is for,"
        f" by {_rms(a['capture'])} against {_rms(b['capture'])}."
    )


def _rms(figures: Mapping[str, Any]) -> str:
    return f"{figures[_RMS] * 1e3:.1f} mm and {figures['rotation_rmse_deg']:.2f}°"


def _percent(share: float | None) -> str:
    return "an unknown share" if share is None else f"{share * 100.0:.1f} %"
