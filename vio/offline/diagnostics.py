"""What a run's own counts say against it: a warning a line, with its cause where it is known."""

from dataclasses import replace

from vio.filter import eskf as flt
from vio.filter.eskf import ErrorStateFilter
from vio.localize.localizer import Localizer
from vio.localize.run import RunResult
from vio.setup_check.unmapped_tags import other_family
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

REJECTED = (*flt.REFUSED, "pose_not_finite")


def run_warnings(
    log: FlightLog, result: RunResult, vio: Localizer | None, *, explained: bool, all_tags: bool
) -> list[str]:
    """All that a run says against itself; all_tags: none of the map was left out."""
    said = [] if vio is None else filter_doubts(vio, log, result, explained=explained)
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
        said += [] if other is None else [other]
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
