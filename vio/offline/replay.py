"""What `run` and `compare` do alike: a log through the localizer, and the files they leave."""

import logging
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vio.config import Config
from vio.errors import EvaluationError, LogError
from vio.filter import eskf as flt
from vio.interrupt import gently
from vio.localize.baselines import Estimator, VoFir, VoKf, VoOnly
from vio.localize.localizer import Localizer
from vio.localize.run import RunResult, Sink, run
from vio.localize.stopwatch import Stopwatch
from vio.localize.warmup import warm_all
from vio.offline.choice import Choice, open_all
from vio.offline.diagnostics import REJECTED, CornerFit, run_warnings, stopped, verdicts
from vio.setup_check.watch import SetupWatch
from vio.sources.flight_log.log import FlightLog
from vio.sources.imu_check import check_imu, check_stamps
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from tagvo.pipeline import Trace
    from vio.evaluate.filter_log import FilterLogRecorder
    from vio.evaluate.tag_sightings import SightingBook
    from vio.setup_check.findings import Finding
    from vio.sinks.live_view import LiveView


LOG = logging.getLogger("vio.commands")


@dataclass(frozen=True, slots=True)
class Replayed:
    """A log that was run: with what configuration, what came out, how long the stages took.

    vio: the localizer, None where its filter did not run; warnings: what a person should know;
    setup: what contradicts the files; refused: it ended for one of them that is beyond doubt.
    """

    log: FlightLog
    config: Config
    result: RunResult
    timing_ms: dict[str, dict[str, float]]
    vio: Localizer | None
    warnings: list[str]
    setup: "list[Finding]"
    refused: bool = False
    book: "SightingBook | None" = None
    filter_log: "FilterLogRecorder | None" = None


def replay_log(
    choice: Choice,
    baselines: "Callable[[FlightLog, Config], Sequence[Estimator]]",
    *,
    vo_only: bool,
    needs_truth: bool = False,
    inspect: bool = False,
    force: bool = False,
    view: "tuple[int | None, Path | None]" = (None, None),
) -> Replayed:
    """Run a log through a localizer (vo_only: without its filter) and what it is compared with.

    inspect: also keep what was seen of the map and what the filter believed, for a report; view:
    port and MCAP file of a live view; force: run on where the set-up is wrong beyond doubt.
    """
    log, config = _opened(choice, needs_truth)
    with waiting("loading compiled code (the first run compiles it, up to a minute)"):
        vio_too = None if vo_only or log.imu is None else config.vio
        warm_all(log.tag_map, log.camera, config.tagvo, vio_too)
    watch = Stopwatch()
    setup = _setup_watch(log, vo_only)
    if setup.certain and not force:
        return Replayed(log, config, RunResult(), {}, None, log.warnings, setup.findings, True)
    localizer = Localizer(
        log.camera, log.tag_map, config, log.imu_noise, imu=vio_too is not None, lap=watch.lap
    )
    vio, warnings = None if vio_too is None else localizer, [] if vo_only else _imu_words(log)
    book, filter_log, look = _inspectors(log, config, vio) if inspect else (None, None, _no_look)
    shown = _view(log, config, vio, view)
    fit = CornerFit()
    looks = _all(setup.look, fit.look, look, *([] if shown is None else [shown.look]))
    sinks: list[Sink] = [setup, *([] if shown is None else [shown])]
    try:
        with progress(log.frame_count, "frames") as step, gently() as stop:
            ends = stop if force else lambda: stop() or setup.certain
            result = run(
                log.events(), localizer, baselines(log, config), watch,
                each_frame=step, stop=ends, sinks=sinks, look=looks,
            )  # fmt: skip
            ended = result.interrupted
            result.interrupted = stop() or (ended and (force or not setup.certain))
    finally:
        if shown is not None:
            shown.close()
    setup.settle()
    if log.frame_count and not result.frames and not result.interrupted and not setup.certain:
        raise LogError(f"{log.path}: not one of {log.frame_count} images could be read"
                       f" ({'; '.join(log.warnings)})")  # fmt: skip
    warnings += run_warnings(
        log, result, vio, fit, {f.code for f in setup.findings}, all_tags=choice.only_tags is None
    )
    said = [*log.warnings, *warnings, *stopped(log, result, early=ended)]
    refused = setup.certain and not force
    return Replayed(
        log, config, result, watch.summary(), vio, said, setup.findings, refused, book, filter_log
    )


def _opened(choice: Choice, needs_truth: bool) -> tuple[FlightLog, Config]:
    """As `open_all`; EvaluationError where truth is needed and the log has none."""
    log, config = open_all(choice)
    if needs_truth and log.truth is None:
        raise EvaluationError(
            f"{log.path}: no truth to compare with;"
            " mav0/state_groundtruth_estimate0/data.csv is needed (`tagvio run` needs none)"
        )
    return log, config


def _setup_watch(log: FlightLog, vo_only: bool) -> SetupWatch:
    """The set-up check of a log, with what its stamps alone tell."""
    watch = SetupWatch(log.camera, log.tag_map, with_imu=log.imu is not None and not vo_only)
    stamps = np.array([], dtype=np.int64) if log.imu is None else log.imu.t_ns
    unit = check_stamps(stamps, log.frames.t_ns, str(log.path))
    watch.stated = [] if unit is None else [unit]
    return watch


def _no_look(trace: "Trace") -> None:
    return None


def _view(
    log: FlightLog, config: Config, vio: Localizer | None, view: "tuple[int | None, Path | None]"
) -> "LiveView | None":
    port, mcap = view
    if port is None and mcap is None:
        return None
    from vio.sinks.live_view import LiveView

    shown = LiveView(
        log.tag_map, log.camera, port=port, mcap=mcap, beliefs=None if vio is None else vio.filter,
        reject_weight=config.tagvo.joint.reject_weight, lossless=True,
    )  # fmt: skip
    if shown.port is not None:
        LOG.warning("live view: ws://127.0.0.1:%d, in Foxglove or any viewer of its", shown.port)
    return shown


def _all(*looks: "Callable[[Trace], None]") -> "Callable[[Trace], None]":
    def look(trace: "Trace") -> None:
        for one in looks:
            one(trace)

    return look


def _inspectors(
    log: FlightLog, config: Config, vio: Localizer | None
) -> "tuple[SightingBook, FilterLogRecorder | None, Callable[[Trace], None]]":
    """What writes down the sightings and the filter's beliefs, and what shows both a frame."""
    from vio.evaluate.filter_log import FilterLogRecorder
    from vio.evaluate.tag_sightings import SightingBook

    book = SightingBook(config.tagvo.joint.reject_weight)
    core = None if vio is None else vio.filter
    filter_log = None if core is None else FilterLogRecorder(core, log.camera.R_CI.T)

    def look(trace: "Trace") -> None:
        book.note(trace)
        if filter_log is not None:
            filter_log.record(trace.t_ns)

    return book, filter_log, look


def _imu_words(log: FlightLog) -> list[str]:
    """What a person should know of the log's IMU before it is used."""
    if log.imu is None:
        return [f"{log.path}: no IMU, so visual odometry runs alone (no vio)"]
    shift = round(log.camera.timeshift_s * 1e9)
    return check_imu(log.imu, log.frames.t_ns + shift, str(log.path))


def vo_baselines(log: FlightLog, config: Config) -> list[Estimator]:
    """`vo` and `vo_fir`; the FIR is the configured one, the paper's where none is."""
    taps = "paper" if config.tagvo.fir == "none" else config.tagvo.fir
    return [VoOnly(log.camera), VoFir(log.camera, taps, config.tagvo.fir_gap_s)]


def all_baselines(log: FlightLog, config: Config) -> list[Estimator]:
    """All that a comparison sets beside the filter: `vo`, `vo_fir` and `vo_kf`."""
    return [*vo_baselines(log, config), VoKf(log.camera)]


def frame_counts(done: Replayed) -> dict[str, int | None]:
    """The `frames` of run.json and comparison.json; None: no filter ran."""
    counts: dict[str, int | None] = {
        "total": done.result.frames,
        "with_pose": done.result.with_pose,
        "fused": None,
        "rejected": None,
    }
    if done.vio is not None:
        counts["fused"] = verdicts(done.vio, flt.TAKEN)
        counts["rejected"] = verdicts(done.vio, REJECTED)
    return counts


def _frames_by_id(frames: "Counter[int]") -> dict[str, int]:
    return {str(tag_id): n for tag_id, n in sorted(frames.items())}


def run_summary(done: Replayed) -> dict[str, Any]:
    """The content of `run.json`."""
    result, filtered = done.result, Counter[str]()
    if done.vio is not None and done.vio.filter is not None:
        filtered = Counter(done.vio.filter.counters)
    verdicts = {v: filtered.pop(v) for v in REJECTED if v in filtered}
    return {
        "frames": frame_counts(done),
        "imu": {"total": result.imu, **{k: v for k, v in filtered.items() if k[:4] == "imu_"}},
        "rejected": dict(sorted((result.reasons + Counter(verdicts)).items())),
        "states": {} if done.vio is None else dict(sorted(done.vio.states.items())),
        "timing_ms": done.timing_ms,
        "counters": dict(sorted((result.counters + Counter(done.log.counters) + filtered).items())),
        "tags_not_on_map": _frames_by_id(result.unmapped.not_on_map),
        "tags_seen_twice": _frames_by_id(result.unmapped.twice),
        "warnings": done.warnings,
        "setup": [finding.plain() for finding in done.setup],
        "interrupted": result.interrupted,
    }
