"""Draws the frames of a recording one after the other, two or more at a time, always the same."""

from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from tagvo.records import Frame
from vio.sim.recording import Recording, stream_of
from vio.sim.scenario import Scenario
from vio.sim.sensors.perfect_detector import sighted


def frames(
    recording: Recording, scenario: Scenario, *, corners: bool, workers: int, first: int = 0
) -> Generator[Frame, None, None]:
    """The frames from the first on in order of exposure, with images or with exact corners.

    To be closed where it is not used up, so that no image is being drawn any more.
    """
    rows = range(first, len(recording.frames))
    if corners:
        yield from (_corners(recording, scenario, k) for k in rows)
        return
    with ThreadPoolExecutor(workers) as pool:
        drawn: deque[Future[Frame]] = deque()
        try:
            for k in rows:
                drawn.append(pool.submit(_image, recording, scenario, k))
                if len(drawn) > 2 * workers:
                    yield drawn.popleft().result()
            while drawn:
                yield drawn.popleft().result()
        finally:  # closed early: what is being drawn ends, nothing else begins
            pool.shutdown(cancel_futures=True)


def _corners(recording: Recording, scenario: Scenario, k: int) -> Frame:
    """Hidden and torn tags are not found; all else that troubles a detector is not looked at."""
    there = recording.scene.tag_map
    whole = there.only(np.setdiff1d(there.tag_id, recording.scene.torn))
    found = sighted(
        whole, recording.true_camera, recording.pose_at,
        float(recording.frames.t_s[k]), scenario.corners, stream_of(scenario, "corners", k),
        readout_s=scenario.lens.readout_s,
    )  # fmt: skip
    t_ns, arrival_ns = _times(recording, k)
    return Frame(t_ns, detections=found, arrival_ns=arrival_ns)


def _image(recording: Recording, scenario: Scenario, k: int) -> Frame:
    from tagvo.render.view import render_frame

    image = render_frame(
        recording.scene, recording.true_camera, recording.pose_at,
        float(recording.frames.t_s[k]), scenario.lens, stream_of(scenario, "image", k),
    )  # fmt: skip
    t_ns, arrival_ns = _times(recording, k)
    return Frame(t_ns, image=image, arrival_ns=arrival_ns)


def _times(recording: Recording, k: int) -> tuple[int, int]:
    return int(recording.frames.t_ns[k]), int(recording.frames.arrival_ns[k])
