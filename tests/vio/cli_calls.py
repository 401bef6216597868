"""Calls `tagvio` in this process as a user would, and writes logs whose truth is exact."""

import contextlib
import io
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from once import once
from simulated import DOWN, corners_seen, grid_map, pinhole
from small_log import DETECTIONS_HEADER, FRAMES_HEADER, TRUTH_HEADER

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera, save_camera
from tagvo.tags.tag_map import save_map
from vio.cli import main

T0, STEP = 1_403_638_519_492_829_441, 50_000_000
R_CI, P_CI = geo.exp(np.array([0.1, -0.2, 1.5])), np.array([0.03, 0.10, -0.05])
TIMESHIFT_S = -0.004
# Two seconds over the arena, for `tagvio simulate`.
SHORT = [
    "flight.name=waypoints", "flight.waypoints=[[0,1.5,2.0,0.9,0],[2,1.5,2.6,1.2,20]]",
    "flight.takeoff=false", "scene.texture.kind=plain", "imu.raw_hz=null", "imu.low_pass=null",
    "stream.rate_hz=10",
]  # fmt: skip
SET_SHORT = [x for s in SHORT for x in ("--set", s)]


@dataclass(frozen=True)
class Done:
    """What a call left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str


def tagvio(*words) -> Done:
    """Run the command with these words; a traceback comes out as the exception it is."""
    out, err, argv = io.StringIO(), io.StringIO(), sys.argv
    sys.argv = ["tagvio", *map(str, words)]
    code = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as stop:
        code = stop.code or 0
    finally:
        sys.argv = argv
    return Done(code, out.getvalue(), err.getvalue())


def rendered_log(tmp_path_factory) -> Path:
    """Two seconds of images, IMU and truth, drawn once for all workers; to be read alone."""

    def make(root):
        done = tagvio("simulate", "t1_qr", "--out", root / "log", *SET_SHORT)
        assert done.code == 0, done.err

    return once(tmp_path_factory, "rendered", make) / "log"


def write_true_log(root: Path, frames: int = 12, speed: float = 0.4, **map_keys) -> Path:
    """A log of exact corners over 3 x 3 tags from a camera beside a level IMU that flies along x.

    Truth is that of I at the frames' stamps in the IMU's clock; at one end of it no tag is seen.
    """
    log = root / "true"
    tag_map, camera = grid_map(3, [0.1, 0.2], 0.3, **map_keys), pinhole()
    cam, truth = log / "mav0/cam0", log / "mav0/state_groundtruth_estimate0"
    cam.mkdir(parents=True)
    truth.mkdir(parents=True)
    save_map(tag_map, log / "tagmap.yaml")
    camera = pinhole(R_CI=R_CI, p_CI=P_CI, timeshift_s=TIMESHIFT_S)
    save_camera(camera, log / "camchain-imucam.yaml")
    stamps, corners, poses = [], [], []
    for i in range(frames):
        t_ns = T0 + i * STEP
        p_WC = np.array([-0.2 + speed * i * STEP * 1e-9, 0.05, 0.9])
        R_WC = DOWN @ geo.exp(np.array([0.05, 0.03, 0.1 * i]))
        rows, pixels = corners_seen(tag_map, camera, R_WC, p_WC)
        for row in rows:
            cells = ",".join(f"{x:.12g}" for x in pixels[row].ravel())
            corners.append(f"{t_ns},{tag_map.tag_id[row]},{cells}\n")
        R_WI, p_WI = geo.compose(R_WC, p_WC, R_CI, P_CI)
        q = geo.quat_from_matrix(R_WI)
        numbers = ",".join(f"{x:.12g}" for x in [*p_WI, *q])
        poses.append(f"{t_ns + round(TIMESHIFT_S * 1e9)},{numbers}\n")
        stamps.append(f"{t_ns},{t_ns}.png\n")
    (cam / "data.csv").write_text(FRAMES_HEADER + "".join(stamps))
    (cam / "detections.csv").write_text(DETECTIONS_HEADER + "".join(corners))
    (truth / "data.csv").write_text(TRUTH_HEADER.replace("[,v_x,v_y,v_z]", "") + "".join(poses))
    assert load_camera(log / "camchain-imucam.yaml").timeshift_s == TIMESHIFT_S
    return log
