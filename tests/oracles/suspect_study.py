"""Flights over a floor on which one tag was moved after it was measured, or none."""

from dataclasses import replace

import numpy as np

from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from vio.evaluate.moved_tags import judge_tags
from vio.evaluate.tag_sightings import SightingBook
from vio.sim.recording import simulated
from vio.sim.scenario import load_scenario
from vio.sim.sensors.image_stream import frames

MOVED_M = 0.03


def flight(seed, scenario="t1_qr", words=("stream.rate_hz=10",), corners=True):
    """A recording and its frames."""
    chosen = load_scenario(scenario, (f"seed={seed}", *words))
    recording = simulated(chosen)
    return recording, list(frames(recording, chosen, corners=corners, workers=1))


def judged(recording, seen, moved=None):
    """Ids of the suspects, and the judgement; moved: (row of the map, offset in W (3,))."""
    tag_map = recording.tag_map
    if moved is not None:
        row, offset = moved
        p_WT = tag_map.p_WT.copy()
        p_WT[row] -= offset  # the map has it where it was
        tag_map = replace(tag_map, p_WT=p_WT)
    config = TagvoConfig()
    vo, book = TagVO(recording.camera, tag_map, config), SightingBook(config.joint.reject_weight)
    for frame in seen:
        book.note(vo.trace(frame))
    found = judge_tags(book.sightings(), tag_map)
    return set(tag_map.tag_id[found.row[found.suspect]].tolist()), found


def a_tag(recording, seen, rng):
    """A row of the map that many frames see, and a way of 3 cm on the floor."""
    config = TagvoConfig()
    vo = TagVO(recording.camera, recording.tag_map, config)
    counts = np.zeros(len(recording.tag_map), dtype=int)
    for frame in seen[::3]:
        counts[vo.trace(frame).observations.row] += 1
    row = int(rng.choice(np.flatnonzero(counts >= 8)))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return row, MOVED_M * np.array([np.cos(angle), np.sin(angle), 0.0])
