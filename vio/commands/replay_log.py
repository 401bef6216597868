"""What `run` and `compare` do alike: a log through tagvo and its arms, and the files they leave."""

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tagvo.pipeline import TagVO
from vio.arms import Estimator, VoArm, VoFirArm
from vio.commands.options import Choice, open_all, progress, waiting
from vio.config import Config
from vio.errors import EvaluationError
from vio.estimator import FUSED, REFUSED, USUAL_NOISE
from vio.estimator import Estimator as FilterEstimator
from vio.filter_arm import VioArm, VoKfArm
from vio.imucheck import check_imu
from vio.run import RunResult, run
from vio.sources.log import FlightLog
from vio.stopwatch import Stopwatch
from vio.warmup import warm_up

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


@dataclass(frozen=True, slots=True)
class Replayed:
    """A log that was run: with what configuration, what came out, how long the stages took."""

    log: FlightLog
    config: Config
    result: RunResult
    timing_ms: dict[str, dict[str, float]]


def replay_log(
    choice: Choice,
    arms: "Callable[[FlightLog, Config], Sequence[Estimator]]",
    *,
    needs_truth: bool = False,
) -> Replayed:
    """Run a log as the options say through the arms made for it."""
    log, config = open_all(choice)
    if needs_truth and log.truth is None:
        raise EvaluationError(
            f"{log.path}: no truth to compare with;"
            " mav0/state_groundtruth_estimate0/data.csv is needed (`tagvio run` needs none)"
        )
    with waiting("loading compiled code (the first run compiles it, up to a minute)"):
        warm_up(log.camera, config.tagvo)
    watch = Stopwatch()
    vo = TagVO(log.camera, log.tag_map, config.tagvo, lap=watch.lap)
    with progress(log.frame_count, "frames") as step:
        result = run(log.events(), vo, arms(log, config), watch, step)
    return Replayed(log, config, result, watch.summary())


def vo_arms(log: FlightLog, config: Config) -> list[Estimator]:
    """`vo` and `vo_fir`; the FIR is the configured one, the paper's where none is."""
    taps = "paper" if config.tagvo.fir == "none" else config.tagvo.fir
    return [VoArm(log.camera), VoFirArm(log.camera, taps, config.tagvo.fir_gap_s)]


def all_arms(log: FlightLog, config: Config) -> list[Estimator]:
    """The VO's arms, its Kalman filter, and the filter where the log has an IMU."""
    arms: list[Estimator] = [*vo_arms(log, config), VoKfArm(log.camera)]
    if log.imu is None:
        return arms
    where = f"{log.path} IMU"
    log.warnings.extend(check_imu(log.imu, log.frames.t_ns, where))
    noise = log.imu_noise or USUAL_NOISE
    filter_ = FilterEstimator(config.vio, log.camera, noise, log.tag_map, config.tagvo.floor)
    vo = TagVO(log.camera, log.tag_map, config.tagvo)
    return [*arms, VioArm(filter_, vo, config.vio.update == "corners")]


def frame_counts(result: RunResult) -> dict[str, int | None]:
    """The `frames` of run.json and comparison.json; None: no filter ran."""
    arm = _vio_arm(result)
    of = None if arm is None else arm.estimator.counters
    return {
        "total": result.frames,
        "with_pose": result.with_pose,
        "fused": None if of is None else sum(of.get(k, 0) for k in FUSED),
        "rejected": None if of is None else sum(of.get(k, 0) for k in REFUSED),
    }


def _vio_arm(result: RunResult) -> VioArm | None:
    return next((a for a in result.estimators if isinstance(a, VioArm)), None)


def run_summary(done: Replayed) -> dict[str, Any]:
    """The content of `run.json`."""
    result, arm = done.result, _vio_arm(done.result)
    counters = result.counters + Counter(done.log.counters)
    if arm is not None:
        counters.update({f"vio_{k}": n for k, n in arm.estimator.counters.items()})
    return {
        "frames": frame_counts(result),
        "imu": {"total": result.imu},
        "rejected": dict(sorted(result.reasons.items())),
        "states": {} if arm is None else dict(sorted(arm.states.items())),
        "timing_ms": done.timing_ms,
        "counters": dict(sorted(counters.items())),
        "warnings": done.log.warnings,
        "interrupted": result.interrupted,
    }
