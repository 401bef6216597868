#!/usr/bin/env python3
"""Frames per second of the renderer, 640 x 480, by what is wrong with the picture.

    python tools/bench_render.py [--frames 60] [--processes 2] [--png] [--only everything]

A camera with a common lens flies over the arena's floor at 0.5 m/s and 0.5 to 2 m. Each row turns
on one nuisance, the last ones all. Columns: milliseconds of processor time a frame, its ratio to
the clean picture's, and frames per second by the wall clock in one process and in several at once
(other work on the machine slows these). `--png` writes each frame as a file, too.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is loaded

import argparse
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from functools import lru_cache
from pathlib import Path
from time import perf_counter, process_time

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated import DOWN, arena

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.render.scene import LensConfig, Scene, SceneConfig, make_scene
from tagvo.render.view import render_frame, render_view

COEFFS = np.array([-0.18, 0.05, 1e-3, -5e-4])
CAMERA = Camera("radtan", np.array([530.0, 530.0, 319.5, 239.5]), COEFFS, (640, 480))
FLIGHT_S = 16.0
OBJECTS = {"hidden_share": 0.1, "torn_share": 0.1, "occluders": {"count": 20, "size_m": 0.15}}
LIGHT = {"light": {"hot_spot_share": 0.5, "gradient_share": 0.3, "flicker_share": 0.1}}
NOISE = {"full_well_e": 8000.0, "read_noise_grey": 1.5}
SHUTTER = {"exposure_s": 0.006, "readout_s": 0.02}
CASES: dict[str, tuple[dict, dict]] = {
    "clean": ({}, {}),
    "tags laid badly": ({"laying_scale": 1.0}, {}),
    "hidden, torn, objects": (OBJECTS, {}),
    "floor of wood, 3 in 10 hidden": ({"hidden_share": 0.3, "texture": {"kind": "wood"}}, {}),
    "uneven light": (LIGHT, {}),
    "glare": ({"glare": {"peak_grey": 150.0}}, {}),
    "vehicle's shadow": ({"shadow": {"darkness_share": 0.5}}, {}),
    "exposure 6 ms": ({}, {"exposure_s": 0.006}),
    "exposure 15 ms": ({}, {"exposure_s": 0.015}),
    "rolling shutter 20 ms": ({}, {"readout_s": 0.02}),
    "both": ({}, SHUTTER),
    "both, 36 samples a pixel": ({}, {**SHUTTER, "supersample": 6}),
    "defocus 1.5 px": ({}, {"defocus_px": 1.5}),
    "vignetting, gamma": ({}, {"vignetting": 0.3, "gamma": 2.2}),
    "shot and read noise": ({}, NOISE),
    "JPEG": ({}, {"jpeg_quality": 90}),
    "exposure, rolling, noise, wood": (
        {"laying_scale": 1.0, "hidden_share": 0.1, "texture": {"kind": "wood"}},
        {**SHUTTER, **NOISE},
    ),
    "everything": (
        {
            "laying_scale": 1.0, **OBJECTS, **LIGHT, "texture": {"kind": "concrete"},
            "glare": {"peak_grey": 150.0}, "shadow": {"darkness_share": 0.5},
        },
        {
            **SHUTTER, **NOISE, "defocus_px": 0.8, "vignetting": 0.3, "gamma": 2.2,
            "jpeg_quality": 90,
        },
    ),
}  # fmt: skip


def pose_at(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A flight along a figure of eight over the arena, turning, at changing heights."""
    w = 2.0 * np.pi / FLIGHT_S
    p = np.stack(
        [1.5 + 0.9 * np.sin(w * t), 2.5 + 0.9 * np.sin(2 * w * t), 1.25 - 0.75 * np.cos(w * t)], -1
    )
    tilt = np.stack([0.06 * np.sin(5 * w * t), 0.06 * np.cos(4 * w * t), 0.4 * t], axis=-1)
    return DOWN @ geo.exp(tilt), p


@lru_cache(maxsize=1)
def scene_of(name: str) -> Scene:
    config = SceneConfig.model_validate(CASES[name][0])
    return make_scene(arena(), config, np.random.default_rng(1))


def shoot(name: str, times: np.ndarray, folder: str | None) -> tuple[float, int]:
    """Render the frames of these times [s]; -> processor seconds used, and frames."""
    cv2.setNumThreads(1)
    scene, lens = scene_of(name), LensConfig.model_validate(CASES[name][1])
    render_frame(scene, CAMERA, pose_at, 0.0, lens, np.random.default_rng(0))  # loaded, compiled
    start = process_time()
    for t in times.tolist():
        rng = np.random.default_rng(round(1e6 * t))
        image = render_frame(scene, CAMERA, pose_at, t, lens, rng)
        if folder is not None:
            cv2.imwrite(f"{folder}/{t:.6f}.png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return process_time() - start, len(times)


def shoot_views(times: np.ndarray) -> float:
    """The clean map by `render_view`, 16 samples a pixel; -> processor seconds a frame."""
    tag_map = arena()
    R, p = pose_at(times)
    render_view(tag_map, CAMERA, R[0], p[0])
    start = process_time()
    for k in range(len(times)):
        render_view(tag_map, CAMERA, R[k], p[k])
    return (process_time() - start) / len(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=60, help="in each process, for each row")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--png", action="store_true", help="write the frames, too")
    parser.add_argument(
        "--only", action="append", choices=CASES, help="rows, besides the clean one"
    )
    args = parser.parse_args()
    names = ["clean", *(args.only or [n for n in CASES if n != "clean"])]
    many, n = args.processes, args.frames
    times = FLIGHT_S * np.arange(many * n).reshape(n, many).T / (many * n)  # a row a process
    print(f"{'':34s} {'CPU ms':>8s} {'ratio':>6s} {'1 process':>10s} {many} processes")
    clean = 0.0
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(many) as pool:
        where = folder if args.png else None
        for name in names:
            list(pool.map(shoot, [name] * many, times[:, :1], [None] * many))  # scenes are made
            start = perf_counter()
            used, _ = pool.submit(shoot, name, times[0], where).result()
            one = n / (perf_counter() - start)
            ms = 1e3 * used / n
            clean = clean or ms
            start = perf_counter()
            frames = sum(f for _, f in pool.map(shoot, [name] * many, times, [where] * many))
            several = frames / (perf_counter() - start)
            print(
                f"{name:34s} {ms:8.1f} {ms / clean:6.2f} {one:8.1f}/s {several:8.1f}/s", flush=True
            )
    ms = 1e3 * shoot_views(times[0])
    print(f"{'render_view, 16 samples a pixel':34s} {ms:8.1f} {ms / clean:6.2f}")


if __name__ == "__main__":
    main()
