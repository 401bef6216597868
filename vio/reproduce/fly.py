"""Flies one task: its tags are found once, every estimator gets the same, all are judged."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from tagvo.records import Frame
from vio.config import Config, load_config
from vio.config.shipped import config_path
from vio.evaluate.compare import VIEWS
from vio.evaluate.metrics import capture_errors, now_errors
from vio.evaluate.records import Trajectory, Window
from vio.evaluate.truth import TruthTrack, clean_truth
from vio.localize.baselines import Estimator, VoFir, VoOnly
from vio.localize.localizer import Localizer
from vio.localize.run import run, trajectory
from vio.records import Ground, ImuSample, Phase
from vio.reproduce.plan import WHOLE
from vio.reproduce.records import Judge, Score, Task, pooled, scored
from vio.sim.recording import Recording, simulated
from vio.sim.scenario import Scenario, load_scenario
from vio.sim.sensors.image_stream import frames

_OURS = {"NEW": "NEW", "NEW+FIR": "NEW", "JBT in the filter": "JBT"}  # whose configuration
_ON_THE_GROUND = {"still", "takeoff", "land"}
_FIR_GAP_S = 0.5  # slow streams are smoothed, too: five frames, whatever their rate


def fly(task: Task) -> list[Score]:
    """Simulate a task and judge all its estimators; SimulationError where it cannot be flown."""
    scenario = _scenario(task, ())
    recording = simulated(scenario)
    seen = list(found(recording, scenario, task.images))
    return [score for judge in task.judges for score in _judged(task, judge, recording, seen)]


def found(recording: Recording, scenario: Scenario, images: bool) -> Iterator[Frame]:
    """The frames with the tags that the detector finds, or with simulated corners."""
    vo = TagVO(recording.camera, recording.tag_map, TagvoConfig())
    for frame in frames(recording, scenario, corners=not images, workers=1):
        yield replace(frame, image=None, detections=vo.detect(frame)) if images else frame


def _scenario(task: Task, more: tuple[str, ...]) -> Scenario:
    return load_scenario(task.scenario, (f"seed={task.seed}", *task.words, *more))


def _judged(task: Task, judge: Judge, recording: Recording, seen: list[Frame]) -> Iterator[Score]:
    if judge.words:  # another calibration file: the true rig and what it sees stay
        recording = simulated(_scenario(task, judge.words))
    events, truth = list(in_order(recording, seen)), clean_truth(recording.truth)
    spans = windows(recording.phases)
    for arm in judge.arms:
        localizer, baselines = _estimator(arm, recording)
        result = run(events, localizer, baselines)
        ((name, states),) = result.outputs.items()
        path = trajectory(name, states)
        for phase, parts in spans.items():
            names = (judge.study, task.case, phase, arm)
            every = [s for window in parts for s in _scores(names, path, truth, window)]
            for view in VIEWS:
                whole = pooled((s for s in every if s.view == view), task.case, phase)
                if whole is not None:
                    yield whole


def in_order(recording: Recording, seen: Iterable[Frame]) -> Iterator[ImuSample | Frame | Ground]:
    """IMU samples and frames as they arrive, at equal times samples first."""
    imu, shown = recording.imu, list(seen)
    known = [f.t_ns if f.arrival_ns is None else f.arrival_ns for f in shown]
    times = np.concatenate([imu.arrival_ns, np.array(known, dtype=np.int64)])
    for i in np.argsort(times, kind="stable").tolist():
        yield imu.sample(i) if i < len(imu) else shown[i - len(imu)]


def windows(phases: Iterable[Phase]) -> dict[str, list[Window]]:
    """The phases off the ground, those of one name together, and all of them as one."""
    aloft = [p for p in phases if p.name not in _ON_THE_GROUND]
    out: dict[str, list[Window]] = {}
    for p in aloft:
        out.setdefault(p.name, []).append(Window(p.t_start_ns, p.t_end_ns))
    if aloft:
        first, last = min(p.t_start_ns for p in aloft), max(p.t_end_ns for p in aloft)
        out[WHOLE] = [Window(first, last)]
    return out


def _estimator(name: str, recording: Recording) -> tuple[Localizer, list[Estimator]]:
    """A localizer, and what is judged beside it where it has no filter."""
    config, filtered = _config(name), name in ("VIO", "VIO corners", "JBT in the filter")
    localizer = Localizer(
        recording.camera, recording.tag_map, config, recording.noise, imu=filtered
    )
    if filtered:
        return localizer, []
    smoothed = name == "NEW+FIR"
    camera = recording.camera
    return localizer, [VoFir(camera, "paper", _FIR_GAP_S) if smoothed else VoOnly(camera)]


def _config(name: str) -> Config:
    """The configuration of an estimator: the default one, or a column of the paper's."""
    if name in ("joint", "VIO"):
        return load_config(None)
    if name == "VIO corners":
        return load_config(None, ["vio.update=corners"])
    return load_config(config_path(f"paper/{_OURS.get(name, name)}.yaml"))


def _scores(
    names: tuple[str, str, str, str], path: Trajectory, truth: TruthTrack, window: Window
) -> Iterator[Score]:
    for view, errors_of in (("capture", capture_errors), ("now", now_errors)):
        errors = errors_of(path, truth, window)
        e_p = np.linalg.norm(errors.p_W, axis=-1)
        e_o = np.degrees(np.linalg.norm(errors.rotation_I, axis=-1))
        score = scored((*names, view), e_p, e_o, errors.coverage or 0.0)
        if score is not None:
            yield score
