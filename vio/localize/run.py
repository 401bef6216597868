"""The one loop: events of a source through a localizer, and through what it is compared with."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tagvo import geometry as geo
from tagvo.pipeline import Trace
from tagvo.records import Frame
from vio.evaluate.records import Trajectory
from vio.localize.baselines import Estimator
from vio.localize.localizer import Event, Localizer
from vio.localize.stopwatch import Stopwatch
from vio.records import ImuSample, NavState
from vio.setup_check.unmapped_tags import UnmappedTags


class Sink(Protocol):
    """Sees everything that a run takes in and what comes out of it, in order."""

    def event(self, event: Event) -> None:
        """An event is about to be taken."""

    def output(self, name: str, output: NavState) -> None:
        """An estimator has said something new."""


@dataclass(slots=True)
class RunResult:
    """What a run has gathered; grows while it runs, and is whole at every moment.

    outputs by estimator; frames, with_pose, imu: counts; reasons: frames without a pose by cause;
    counters: dropped detections and flags of poses by cause; tags_t_ns, tags_count: tags used in
    each frame; unmapped: tags seen and of no use; interrupted: stopped by the user; reached_ns:
    latest time at which an event that was processed was known, None before the first; keep: gather
    outputs and tags used, false: counts alone, so that a run may last for ever.
    """

    outputs: dict[str, list[NavState]] = field(default_factory=dict)
    frames: int = 0
    with_pose: int = 0
    imu: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    counters: Counter[str] = field(default_factory=Counter)
    tags_t_ns: list[int] = field(default_factory=list)
    tags_count: list[int] = field(default_factory=list)
    unmapped: UnmappedTags = field(default_factory=UnmappedTags)
    interrupted: bool = False
    reached_ns: int | None = None
    keep: bool = True


def run(
    events: Iterable[Event],
    localizer: Localizer,
    baselines: Sequence[Estimator] = (),
    watch: Stopwatch | None = None,
    *,
    each_frame: Callable[[], None] = lambda: None,
    stop: Callable[[], bool] = lambda: False,
    sinks: Sequence[Sink] = (),
    result: RunResult | None = None,
    look: Callable[[Trace], None] = lambda trace: None,
) -> RunResult:
    """Feed events in order to a localizer and what it is compared with; Ctrl-C ends it gently.

    The localizer's states are `vio` of the result where it has a filter. each_frame: called after
    every frame; stop: asked before every event, true ends it; result: where it gathers, None: a new
    one; look: shown every frame's intermediates once all have taken them.
    """
    result, watch = result or RunResult(), watch or Stopwatch()
    result.outputs.update({e.name: [] for e in baselines})
    if localizer.filter is not None:
        result.outputs["vio"] = []
    try:
        for event in events:
            if stop():
                result.interrupted = True
                break
            for sink in sinks:
                sink.event(event)
            _reach(result, event)
            if not isinstance(event, Frame):
                result.imu += isinstance(event, ImuSample)
                _keep(result, "vio", localizer.process(event), sinks)
                continue
            watch.start()
            state = localizer.process(event)
            trace = localizer.trace
            assert trace is not None
            for estimator in baselines:
                _keep(result, estimator.name, estimator.pose(event, trace.pose), sinks)
            if localizer.filter is not None:
                _keep(result, "vio", state, sinks)
            watch.lap("arms")
            watch.stop()
            _count(result, trace)
            result.unmapped.take(trace.detections, trace.counts, localizer.vo.tag_map)
            look(trace)
            each_frame()
    except KeyboardInterrupt:
        result.interrupted = True
    return result


def _reach(result: RunResult, event: Event) -> None:
    known_ns = event.arrival_ns
    if known_ns is None:
        assert isinstance(event, Frame)
        known_ns = event.t_ns
    if result.reached_ns is None or known_ns > result.reached_ns:
        result.reached_ns = known_ns


def _keep(result: RunResult, name: str, state: NavState | None, sinks: Sequence[Sink]) -> None:
    """Keep one state a stamp: at equal times of arrival the later word counts, else the first."""
    if state is None:
        return
    for sink in sinks:
        sink.output(name, state)
    if not result.keep:
        return
    states = result.outputs[name]
    if not states or states[-1].t_ns != state.t_ns:
        states.append(state)
    elif states[-1].known_ns == state.known_ns:
        states[-1] = state


def _count(result: RunResult, trace: Trace) -> None:
    result.frames += 1
    result.counters.update({cause: n for cause, n in trace.counts.items() if n})
    used = 0
    if trace.pose is not None:
        result.with_pose += 1
        result.counters.update(f"pose_{flag}" for flag in trace.pose.flags)
        used = len(trace.pose.tag_ids)
    elif trace.reason is not None:
        result.reasons[trace.reason] += 1
    if result.keep:
        result.tags_t_ns.append(trace.t_ns)
        result.tags_count.append(used)


def trajectory(name: str, outputs: Sequence[NavState]) -> Trajectory:
    """The states of one estimator as arrays, in the order in which they were known."""
    n = len(outputs)
    velocities = [o.v_WI for o in outputs if o.v_WI is not None]
    covariances = [o.cov[:6, :6] for o in outputs if o.cov is not None]
    return Trajectory(
        name,
        np.array([o.t_ns for o in outputs], dtype=np.int64),
        np.array([o.t_ns if o.known_ns is None else o.known_ns for o in outputs], dtype=np.int64),
        np.array([o.p_WI for o in outputs]).reshape(n, 3),
        np.array([o.R_WI for o in outputs]).reshape(n, 3, 3),
        np.array(velocities) if n and len(velocities) == n else None,
        np.array(covariances) if n and len(covariances) == n else None,
    )


def tum_rows(
    one: Trajectory,
) -> tuple[
    "np.ndarray[tuple[int, ...], np.dtype[np.int64]]",
    "np.ndarray[tuple[int, ...], np.dtype[np.float64]]",
    "np.ndarray[tuple[int, ...], np.dtype[np.float64]]",
]:
    """Stamps (n,), positions (n, 3), quaternions wxyz (n, 4) in ascending order of stamp."""
    order = np.argsort(one.t_ns, kind="stable")
    return one.t_ns[order], one.p_WI[order], geo.quat_from_matrix(one.R_WI[order])
