"""What the pose costs after detection, as ratios to a loop of OpenCV's IPPE over the same tags.

Frame by frame in one process and one thread, in turns: the loop, the paper's path, the joint pose.
Run: python tools/bench_vo.py [--frames 600] [--tags 30] [--cpu]
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is loaded

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import perf_counter_ns, thread_time_ns

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated import arena, corners_seen, pinhole, pose_above

from tagvo.camera.model import Camera
from tagvo.config import TagvoConfig
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame
from tagvo.render.view import displaced
from tagvo.tags.tag_map import TagMap, tag_corners

STAGES = ("detect", "tagpose", "select", "fuse", "joint")
HEIGHT = 1.3  # m; 30 tags and more are in view almost everywhere


class Laps:
    """Milliseconds of each stage of each frame, by the `lap` hook of TagVO."""

    def __init__(self, cpu: bool) -> None:
        self._clock = thread_time_ns if cpu else perf_counter_ns
        self.ms: dict[str, list[float]] = {stage: [] for stage in (*STAGES, "whole")}
        self._start = self._last = 0

    def begin(self) -> None:
        self._start = self._last = self._clock()

    def lap(self, stage: str) -> None:
        now = self._clock()
        self.ms[stage].append((now - self._last) * 1e-6)
        self._last = now

    def end(self) -> None:
        self.ms["whole"].append((self._clock() - self._start) * 1e-6)


def frames_with(tags: int, count: int, tag_map: TagMap, camera: Camera) -> list[Frame]:
    """`count` frames with exactly so many tags, laid as the map states: a choice of those seen."""
    rng = np.random.default_rng(7)
    low, high = tag_map.p_WT[:, :2].min(axis=0), tag_map.p_WT[:, :2].max(axis=0)
    frames: list[Frame] = []
    while len(frames) < count:
        pose = pose_above(rng, HEIGHT, low, high)
        rows, pixels = corners_seen(displaced(tag_map, rng), camera, *pose, margin_px=12.0)
        if len(rows) < tags:
            continue
        rows = np.sort(rng.permutation(rows)[:tags])
        noisy = pixels[rows] + 0.3 * rng.standard_normal((tags, 4, 2))
        frames.append(Frame(len(frames), detections=Detections.of(tag_map.tag_id[rows], noisy)))
    return frames


def ippe_loop(points: list[np.ndarray], corners: list[np.ndarray], K: np.ndarray, d: np.ndarray):
    """What most software does: one call a tag; pixel corners in, both poses of each tag out."""
    return [
        cv2.solvePnPGeneric(X, x, K, d, flags=cv2.SOLVEPNP_IPPE_SQUARE)
        for X, x in zip(points, corners, strict=True)
    ]


def measure(frames: list[Frame], tag_map: TagMap, camera: Camera, cpu: bool) -> dict[str, Laps]:
    """Times of the loop, the paper's path and the joint pose, interleaved frame by frame."""
    laps = {name: Laps(cpu) for name in ("loop", "fused", "joint")}
    new = TagvoConfig(pose="fused", ambiguity="first")  # TBS-OR-(W2+QL2), the defaults
    vos = {
        "fused": TagVO(camera, tag_map, new, lap=laps["fused"].lap),
        "joint": TagVO(camera, tag_map, lap=laps["joint"].lap),
    }
    fu, fv, pu, pv = camera.intrinsics
    K, d = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]), camera.coeffs
    objects = {int(t): tag_corners(s) for t, s in zip(tag_map.tag_id, tag_map.size, strict=True)}
    for k, frame in enumerate([*frames[:20], *frames]):
        if k == 20:  # warm by now: compiled, in the caches
            for each in laps.values():
                each.ms = {stage: [] for stage in each.ms}
        assert frame.detections is not None
        points = [objects[int(t)] for t in frame.detections.tag_id]
        corners = list(frame.detections.corners_px)
        laps["loop"].begin()
        ippe_loop(points, corners, K, d)
        laps["loop"].end()
        for name, vo in vos.items():
            laps[name].begin()
            vo(frame)
            laps[name].end()
    return laps


def row(name: str, ms: list[float], loop: list[float]) -> str:
    low, high = np.percentile(ms, [50, 99])
    loop_low, loop_high = np.percentile(loop, [50, 99])
    return f"{name:24s} {low / loop_low:9.3f} {high / loop_high:9.3f} {low:9.3f} {high:9.3f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--tags", type=int, default=30)
    parser.add_argument(
        "--cpu",
        action="store_true",
        help="CPU time of the thread: what other processes take is out",
    )
    args = parser.parse_args()
    cv2.setNumThreads(1)
    tag_map = arena()
    coeffs = np.array([-0.18, 0.05, 0.001, -0.0005])
    camera = replace(pinhole(), model="radtan", coeffs=coeffs)
    laps = measure(frames_with(args.tags, args.frames, tag_map, camera), tag_map, camera, args.cpu)
    loop = laps["loop"].ms["whole"]
    print(f"{args.frames} frames of {args.tags} tags; ratios to the loop of solvePnPGeneric")
    print(f"{'':24s} {'ratio p50':>9s} {'ratio p99':>9s} {'p50 ms':>9s} {'p99 ms':>9s}")
    print(row("solvePnPGeneric loop", loop, loop))
    print(row("paper's path, whole", laps["fused"].ms["whole"], loop))
    print(row("joint path, whole", laps["joint"].ms["whole"], loop))
    print(row("joint stage alone", laps["joint"].ms["joint"], loop))
    for name in ("fused", "joint"):
        for stage in STAGES:
            if laps[name].ms[stage]:
                print(row(f"  {name}: {stage}", laps[name].ms[stage], loop))


if __name__ == "__main__":
    main()
