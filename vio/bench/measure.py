"""Runs detectors and the tracker over the same views, interleaved, and sums up what they did."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import TagvoConfig, TrackConfig
from tagvo.detect import Detector, make_detector
from tagvo.detect.peers import PlainAruco, PyAprilTags
from tagvo.detect.protocol import gray_image, no_detections
from tagvo.errors import DetectorError
from tagvo.geometry import Array, shortest_sides
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame
from tagvo.tags.tag_map import TagMap
from tagvo.track import Tracker
from vio.bench.scenes import View
from vio.localize.stopwatch import clocks_ns, resident_mb

REFERENCE = "apriltag-python, decimate 2"
BINS = (8, 12, 16, 20, 40)  # [px] lower ends of the classes of shortest side
_HIT_PX = 3.0  # a find whose corners are all this near is that tag

Way = Callable[[View], Detections]


@dataclass(slots=True)
class Score:
    """What one way did in one scene; recall by bin: (found, of). memory_mb: of making it."""

    memory_mb: float = 0.0
    wall_ms: list[float] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)
    found: "Array" = field(default_factory=lambda: np.zeros(len(BINS)))
    there: "Array" = field(default_factory=lambda: np.zeros(len(BINS)))
    square_px: list[float] = field(default_factory=list)
    false: int = 0
    pose_mm: list[float] = field(default_factory=list)


def ways(tag_map: TagMap, camera: Camera) -> tuple[dict[str, Way], dict[str, float], list[str]]:
    """Every way to find tags that this family and machine allow; its memory [MB]; what is missing.

    The tracker gets the view's prior, a detector the image alone.
    """
    family, bits = tag_map.family, tag_map.border_bits
    makers: dict[str, Callable[[], Way]] = {
        "tagvio tracker": lambda: _tracker(tag_map, camera),
        "tagvio detector": lambda: _plain(make_detector("auto", family, border_bits=bits)),
    }
    if family.apriltag and bits == 1:
        for d in (2, 1):
            makers[f"apriltag-python, decimate {d}"] = lambda d=d: _plain(  # type: ignore[misc]
                make_detector("apriltag", family, decimate=float(d))
            )
            makers[f"pyapriltags, decimate {d}"] = lambda d=d: _plain(  # type: ignore[misc]
                PyAprilTags(family, float(d))
            )
    if family.aruco is not None:
        makers["OpenCV ArUco"] = lambda: _plain(PlainAruco(family, bits))
    made, memory, missing = {}, {}, []
    for name, make in makers.items():
        before = resident_mb()
        try:
            made[name] = make()
        except DetectorError as err:
            missing.append(f"{name}: {err}")
            continue
        memory[name] = resident_mb() - before
    return made, memory, missing


def _plain(detector: Detector) -> Way:
    return lambda view: detector.detect(view.image)


def _tracker(tag_map: TagMap, camera: Camera) -> Way:
    config = TrackConfig(mode="on", sweep_s=0.0, max_tags=200)
    tracker = Tracker(camera, tag_map, config)

    def find(view: View) -> Detections:
        tracked = tracker(gray_image(view.image), 0, view.prior, lambda *_: no_detections())
        return no_detections() if tracked.detections is None else tracked.detections

    return find


def measure(
    views: Iterable[View], tag_map: TagMap, camera: Camera, made: dict[str, Way],
    step: Callable[[], None], stop: Callable[[], bool],
) -> dict[str, Score]:  # fmt: skip
    """Every way over every view, in turns whose order changes; the first view warms up only."""
    scores, names = {name: Score() for name in made}, list(made)
    judge = TagVO(camera, tag_map, TagvoConfig())
    for k, view in enumerate(views):
        if stop():
            break
        for name in names[k % len(names) :] + names[: k % len(names)]:
            if k == 0:
                made[name](view)
            wall, cpu = clocks_ns()
            found = made[name](view)
            wall_end, cpu_end = clocks_ns()
            scores[name].wall_ms.append((wall_end - wall) * 1e-6)
            scores[name].cpu_ms.append((cpu_end - cpu) * 1e-6)
            _compare(scores[name], view, found)
            pose = judge(Frame(0, detections=found))
            if pose is not None:
                scores[name].pose_mm.append(1e3 * float(np.linalg.norm(pose.p_WC - view.p_WC)))
        step()
    return scores


def _compare(score: Score, view: View, found: Detections) -> None:
    """Which of the tags in view were found, how well, and what was found that is not there."""
    kind = np.searchsorted(BINS, shortest_sides(view.corners_px), side="right") - 1
    at = {int(t): i for i, t in enumerate(view.tag_id)}
    hit = np.zeros(len(view.tag_id), dtype=bool)
    for tag_id, corners in zip(found.tag_id.tolist(), found.corners_px, strict=True):
        if tag_id not in at:
            continue  # cut by the rim, or not to be judged
        error = corners - view.corners_px[at[tag_id]]
        if np.abs(error).max() < _HIT_PX:
            hit[at[tag_id]] = True
            score.square_px += np.square(error).sum(axis=1).tolist()
        else:
            score.false += 1
    for b in range(len(BINS)):
        score.there[b] += float((kind == b).sum())
        score.found[b] += float((hit & (kind == b)).sum())


def figures(score: Score, reference: Score | None) -> dict[str, Any]:
    """The figures of one way in one scene; ratios to the reference first, null: not to be had."""
    ratios: dict[str, float | None] = {"faster_cpu_p50": None, "faster_wall_p50": None}
    if reference is not None and reference.cpu_ms and score.cpu_ms:
        ratios = {
            "faster_cpu_p50": float(np.median(reference.cpu_ms) / np.median(score.cpu_ms)),
            "faster_wall_p50": float(np.median(reference.wall_ms) / np.median(score.wall_ms)),
        }
    recall = {
        str(low): None if not there else round(float(found / there), 4)
        for low, found, there in zip(BINS, score.found, score.there, strict=True)
    }
    return {
        **ratios,
        "cpu_ms": _spread(score.cpu_ms),
        "wall_ms": _spread(score.wall_ms),
        "recall_by_px": recall,
        "corner_rms_px": _root_mean(score.square_px),
        "off_3px": score.false,
        "pose_median_mm": float(np.median(score.pose_mm)) if score.pose_mm else None,
        "frames_with_pose": len(score.pose_mm),
        "memory_mb": round(score.memory_mb, 1),
        "frames": len(score.wall_ms),
    }


def _spread(ms: list[float]) -> dict[str, float] | None:
    if not ms:
        return None
    low, high = np.percentile(ms, [50, 99])
    return {"p50": round(float(low), 4), "p99": round(float(high), 4)}


def _root_mean(squares: list[float]) -> float | None:
    return float(np.sqrt(np.mean(squares))) if squares else None
