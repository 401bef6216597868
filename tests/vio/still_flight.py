"""A vehicle that hovers without moving over the arena, as a folder of images and a configuration.

Its attitude is the one in which the in-test autopilot's IMU feels gravity.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import yaml

from tagvo import geometry as geo
from tagvo.camera.calibration import load_camera
from tagvo.render.view import render_view
from tagvo.tags.tag_map import load_map

CONFIGS = Path(__file__).parents[2] / "configs"
P_WI = np.array([1.5, 2.5, 1.4])
TAGVIO = [sys.executable, "-c", "from vio.cli import main; main()"]


def attitude():
    """R_WI in which a specific force of (0.1, 0.2, 9.81) in the body points up."""
    up = np.array([0.1, 0.2, 9.81])
    up /= np.linalg.norm(up)
    axis = np.cross(up, [0.0, 0.0, 1.0])
    return geo.exp(axis / np.linalg.norm(axis) * np.arcsin(np.linalg.norm(axis)))


def write_images(folder, n=4, seed=5):
    """The same view n times, each with its own noise of the sensor."""
    camera = load_camera(CONFIGS / "cameras/arena.yaml")
    floor = load_map(CONFIGS / "maps/arena.yaml")
    R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
    R_WC, p_WC = geo.compose(attitude(), P_WI, R_IC, p_IC)
    folder.mkdir(parents=True)
    clean = render_view(floor, camera, R_WC, p_WC, supersample=2)
    for k in range(n):
        noise = np.random.default_rng([seed, k]).normal(0.0, 2.0, clean.shape)
        image = np.clip(clean + noise, 0, 255).astype(np.uint8)
        cv2.imwrite(str(folder / f"{k}.png"), image)
    return folder


def write_config(folder, port, *, rate_hz=20.0, name="daemon.yaml", **changes):
    """A configuration in `folder` whose camera is `folder/images`; changes: daemon's keys."""
    daemon = {
        "map": str(CONFIGS / "maps/arena.yaml"),
        "calibration": str(CONFIGS / "cameras/arena.yaml"),
        "camera": {"device": "images", "rate_hz": rate_hz, "repeat": True},
        "record": {"folder": "flights", "min_free_mb": 0},
        "status_file": "status.json",
        "vehicle_wait_s": 20.0,
        **changes,
    }
    mavlink = {"url": f"udpin:127.0.0.1:{port}", "state_file": str(folder / "state.json")}
    path = folder / name
    path.write_text(yaml.safe_dump({"mavlink": mavlink, "daemon": daemon}))
    return path


def limit_s(seconds):
    """The time that is allowed; four times as much on a machine that has more to do than it can."""
    busy = os.getloadavg()[0] > 1.5 * os.cpu_count()
    return 4.0 * seconds if busy else seconds


class Daemon:
    """`tagvio daemon` as a process; within `with` it lives, its words are in `err`."""

    def __init__(self, config, *words, env=None, before=()):
        self.err = config.with_suffix(".err")
        self.folder = config.parent
        with self.err.open("w") as err:
            self.process = subprocess.Popen(
                [*before, *TAGVIO, "daemon", "--config", str(config), *words],
                stderr=err, stdout=subprocess.PIPE, text=True, env={**os.environ, **(env or {})},
            )  # fmt: skip

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.kill()
        self.process.wait()
        self.process.stdout.close()

    def stop(self, how=signal.SIGTERM):
        """Tell it to stop; seconds that it took."""
        start = time.monotonic()
        self.process.send_signal(how)
        self.process.wait(10.0)
        return time.monotonic() - start

    def status(self):
        try:
            return json.loads((self.folder / "status.json").read_text())
        except FileNotFoundError:
            return None

    def said(self, text):
        return text in self.err.read_text()

    def log(self):
        """The folder of its only recording."""
        (path,) = (self.folder / "flights").iterdir()
        return path
