"""Writes a short flight log with an IMU and tag corners whose truth is exact but for the noise."""

from pathlib import Path

import numpy as np
from flights import CAMERA
from simulated import arena, corners_seen
from study_flights import t3

from tagvo import geometry as geo
from tagvo.records import Detections, Frame
from vio.records import ImuSample
from vio.sim.sensors.simple_imu import PIXHAWK, simulate_imu
from vio.sinks.log_writer import LogWriter

START_NS = 1_700_000_000_000_000_000
FRAME_HZ = 10


def write_flying_log(
    root: Path, seconds: float = 6.0, arrival_s: float = 0.06, *, imu: bool = True
) -> Path:
    """T3 over the arena's floor: corners of 0.3 px noise at 10 Hz, known late, an IMU at 200 Hz."""
    rng, tag_map, (flight, _) = np.random.default_rng(3), arena(), t3()
    track, _ = simulate_imu(flight, seconds, PIXHAWK, rng)
    R_IC, p_IC = geo.invert(CAMERA.R_CI, CAMERA.p_CI)
    with LogWriter(root / "flying") as writer:
        writer.setup(tag_map, CAMERA, PIXHAWK if imu else None)
        for i in range(len(track) if imu else 0):
            t_ns = int(track.t_ns[i]) + START_NS
            writer.imu(ImuSample(t_ns, track.gyro_I[i], track.accel_I[i], t_ns))
        t_s = np.arange(int(seconds * FRAME_HZ) + 1) / FRAME_HZ
        truth = flight(t_s)
        q_WI = geo.quat_from_matrix(truth.R_WI)
        for k, t in enumerate(t_s):
            t_ns = START_NS + round(t * 1e9)
            R_WC, p_WC = geo.compose(truth.R_WI[k], truth.p_WI[k], R_IC, p_IC)
            rows, pixels = corners_seen(tag_map, CAMERA, R_WC, p_WC)
            noisy = pixels[rows] + 0.3 * rng.standard_normal((len(rows), 4, 2))
            found = Detections.of(tag_map.tag_id[rows], noisy)
            writer.frame(Frame(t_ns, None, found, t_ns + round(arrival_s * 1e9)))
            writer.truth(t_ns, truth.p_WI[k], q_WI[k], truth.v_WI[k])
    return root / "flying"
