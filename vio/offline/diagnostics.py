"""What a run's own counts say against it: a warning a line, with its cause where it is known."""

from dataclasses import replace

from vio.filter import eskf as flt
from vio.localize.fused import VioArm
from vio.localize.run import RunResult
from vio.setup_check.unmapped_tags import other_family
from vio.sources.flight_log.log import FlightLog
from vio.sources.flight_log.tally import Tally

REJECTED = (*flt.REFUSED, "pose_not_finite")


def stopped(log: FlightLog, result: RunResult, *, by_setup: bool) -> list[str]:
    """How far a run came that did not reach the end of its log, and what stopped it."""
    if not (result.interrupted or by_setup) or result.reached_ns is None:
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


def filter_doubts(vio: VioArm, result: RunResult, where: str) -> list[str]:
    """What the filter's own counts say against it: it never started, or believed few poses."""
    if not result.outputs[vio.name]:
        why = ", ".join(vio.estimator.health().reasons)
        return [f"{where}: the filter never started ({why}); vio.tum is empty"]
    noise = vio.estimator.noise_words
    said = [] if noise is None else [f"{where}: {noise}"]
    fused, rejected = verdicts(vio, flt.TAKEN), verdicts(vio, REJECTED)
    bad = sum(vio.states[state] for state in ("LOST", "RELOCATING"))
    if bad > 0.5 * sum(vio.states.values()):
        why = ", ".join(f"{name} in {n}" for name, n in vio.doubts.most_common(3))
        said.append(
            f"{where}: the filter was LOST or RELOCATING in {bad} of {sum(vio.states.values())}"
            f" samples ({why}): vio is not to be trusted"
        )
    if 2 * rejected <= fused:
        return said
    return [
        *said,
        f"{where}: the filter rejected {rejected} poses and took {fused}: vio is not to be trusted;"
        " are the IMU's units (rad/s, m/s^2), axes, clock and T_cam_imu right?",
    ]


def verdicts(vio: VioArm, names: tuple[str, ...]) -> int:
    """How many poses met one of these fates."""
    counters = vio.estimator.counters
    return sum(counters.get(name, 0) for name in names)
