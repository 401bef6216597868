"""Writes a recording as a flight log in order of time: whatever stops it, what is there flies."""

import errno
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tagvo.camera.calibration import camera_to_yaml
from tagvo.geometry import Array, IntArray
from tagvo.records import Frame
from vio.errors import SimulationError
from vio.sim.recording import Recording
from vio.sinks.log_writer import LogWriter

if TYPE_CHECKING:
    from collections.abc import Callable

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_RIG_HEAD = (
    "# The rig as it really was, in the form of camchain-imucam.yaml, which may differ from it by\n"
    "# the scenario's `calibration`. For those who compare; no estimator may read it.\n"
)


def write_log(
    path: Path,
    recording: Recording,
    pictures: Iterable[Frame],
    scenario_text: str,
    *,
    replace: bool = False,
    step: "Callable[[], None]" = lambda: None,
    stop: "Callable[[], bool]" = lambda: False,
) -> int:
    """The log of a recording with these frames; how many were written before `stop` said so.

    step: called after each frame. LogError where a log stands at path already and is not to be
    replaced, SimulationError where writing fails.
    """
    done = 0
    try:
        with LogWriter(path, replace=replace) as writer:
            _head(writer, recording, scenario_text)
            rows = _Rows(writer, recording)
            for frame in pictures:
                rows.up_to(frame.t_ns if frame.arrival_ns is None else frame.arrival_ns)
                writer.frame(frame)
                done += 1
                step()
                if stop():
                    return done
            rows.up_to(np.iinfo(np.int64).max)
    except OSError as err:
        raise SimulationError(_failure(path, err, done, len(recording.frames))) from None
    return done


def _head(writer: LogWriter, recording: Recording, scenario_text: str) -> None:
    """All that holds for the whole log."""
    writer.setup(recording.tag_map, recording.camera, recording.noise)
    writer.note("scenario.yaml", scenario_text)
    writer.note("truth_rig.yaml", _RIG_HEAD + camera_to_yaml(recording.true_camera))
    if recording.phases:
        writer.phases(recording.phases)


class _Rows:
    """Owns how far IMU and truth of a recording have been written."""

    def __init__(self, writer: LogWriter, recording: Recording) -> None:
        self._writer, self._imu, self._truth = writer, recording.imu, recording.truth
        truth = recording.truth
        both = truth.b_g is not None and truth.b_a is not None
        self._biases: Array | None = np.hstack([truth.b_g, truth.b_a]) if both else None  # type: ignore[list-item]
        self._next_imu = self._next_truth = 0

    def up_to(self, t_ns: int) -> None:
        """Write what stands in the files before the first stamp beyond t_ns."""
        imu, truth = self._imu, self._truth
        end = _before(imu.t_ns, self._next_imu, t_ns)
        for i in range(self._next_imu, end):
            self._writer.imu(imu.sample(i))
        self._next_imu = end
        end = _before(truth.t_ns, self._next_truth, t_ns)
        v_WI = np.full((len(truth), 3), np.nan) if truth.v_WI is None else truth.v_WI
        for i in range(self._next_truth, end):
            biases = None if self._biases is None else self._biases[i]
            self._writer.truth(int(truth.t_ns[i]), truth.p_WI[i], truth.q_WI[i], v_WI[i], biases)
        self._next_truth = end


def _before(t_ns: IntArray, start: int, limit: int) -> int:
    """First row from `start` on whose stamp is beyond the limit."""
    beyond = np.flatnonzero(t_ns[start:] > limit)
    return start + int(beyond[0]) if len(beyond) else len(t_ns)


def _failure(path: Path, err: OSError, done: int, total: int) -> str:
    why = "the disk is full" if err.errno in _FULL else err.strerror or str(err)
    there = f"the {done} of {total} frames before that are a log that can be read"
    file = f" ({err.filename})" if err.filename else ""
    return f"{path}: {why}{file}; {there if done else 'no frame was written'}"
