#!/usr/bin/env python3
"""Cost of the filter's operations beside filterpy's EKF of the same dimension, in one run.

    python tools/bench_filter.py [--repeat 2000]

Medians in microseconds, called from Python; the compile time cold and from cache (its own process).
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

WORK = "import tools.bench_filter as b; b.filled_history(['pose_bias']).insert(*b.late_pose(0))"
ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SHARES = (0.3, 0.15)  # of the pose bias: of position, of rotation


def median_us(work, repeat):
    times = []
    for i in range(repeat):
        args = work[1](i) if isinstance(work, tuple) else ()
        t = time.perf_counter()
        (work[0] if isinstance(work, tuple) else work)(*args)
        times.append(time.perf_counter() - t)
    return 1e6 * float(np.median(times))


def a_state(n):
    from vio.filter import state as at
    from vio.filter.adaptive_noise import no_memory

    x = np.zeros(at.NOMINAL)
    x[[at.X_Q, at.X_QIC, at.X_QWL]] = 1.0
    x[at.X_RECENT :] = no_memory()
    return x, 1e-4 * np.eye(n)


def noise():
    from vio.config.filter import VioConfig
    from vio.filter.noise_model import process_noise
    from vio.sim.sensors.simple_imu import PIXHAWK

    return process_noise(PIXHAWK, VioConfig())


def late_pose(i):
    """Stamp and row of a pose about 90 ms before the window's end, another one each time."""
    from tagvo.records import PoseMeasurement
    from vio.filter.measurements import pose

    t_ns = 910_000_000 + i
    return t_ns, pose.pack(PoseMeasurement(t_ns, np.zeros(3), np.eye(3), 1e-3 * np.eye(6), (0,)))


def filled_history(on):
    """One second of IMU at 200 Hz; on: the switches of the state's blocks."""
    from vio.filter import state as at
    from vio.filter.adaptive_noise import NoisePolicy
    from vio.filter.history import History
    from vio.filter.measurements import kinds, pose
    from vio.filter.noise_model import Model

    layout, policy = at.layout(on), NoisePolicy(4.0, True, False, 0.0, 1.0)
    history = History((300, 5000, kinds.HEAD + pose.NUMBERS), Model(noise(), policy, layout))
    history.start(0, *a_state(layout.n))
    for k in range(1, 201):
        history.add_interval(k * 5_000_000, np.zeros(3), np.array([0.0, 0.0, 9.81]), np.ones(6))
    return history


def ours(on, repeat):
    from vio.filter import state as at
    from vio.filter.adaptive_noise import Trust
    from vio.filter.measurements import kinds, pose
    from vio.filter.propagation import propagate

    q, w, rates = noise(), np.zeros(3), np.array([0.0] * 5 + [9.81] + [1.0] * 6)
    z, y, layout = late_pose(0)[1][kinds.HEAD :], np.empty(6), at.layout(on)
    x, P = a_state(layout.n)
    propagate(x, P, rates, 0.005, q, layout)
    predict = median_us(lambda: propagate(x, P, rates, 0.005, q, layout), repeat)
    P0 = 1e-4 * np.eye(layout.n)
    trust = Trust(4.0, *(SHARES if "pose_bias" in on else (0.0, 0.0)), 1.0)
    pose.update(x, P, w, z, trust, y, layout)

    def fresh(i):
        P[:] = P0
        return (x, P, w, z, trust, y, layout)

    return predict, median_us((pose.update, fresh), repeat)


def delayed(on, repeat):
    """A pose 90 ms late: rewind, insert, 18 IMU steps again; the history is fresh each time."""
    history = filled_history(on)
    row = late_pose(0)[1]
    history.insert(910_000_000, row)

    def fresh(i):
        history.count = 0
        return (910_000_000, row)

    return median_us((history.insert, fresh), repeat)


def theirs(n, repeat):
    from filterpy.kalman import ExtendedKalmanFilter

    ekf = ExtendedKalmanFilter(dim_x=n, dim_z=6)
    ekf.P, ekf.Q, ekf.R = 1e-4 * np.eye(n), 1e-8 * np.eye(n), 1e-3 * np.eye(6)
    ekf.F[:3, 3:6] = 0.005 * np.eye(3)
    H = np.zeros((6, n))
    H[:3, :3] = H[3:, 6:9] = np.eye(3)
    z, P0 = np.zeros((6, 1)), ekf.P.copy()
    predict = median_us(ekf.predict, repeat)

    def fresh(i):
        ekf.P = P0.copy()
        return (z, lambda x: H, lambda x: H @ x)

    return predict, median_us((ekf.update, fresh), repeat)


def seconds_to_first_result(cache):
    """A fresh process until the first delayed pose is in, with this cache folder."""
    environment = dict(os.environ, NUMBA_CACHE_DIR=cache, PYTHONPATH=ROOT)
    t = time.perf_counter()
    subprocess.run([sys.executable, "-c", WORK], check=True, env=environment, cwd=ROOT)
    return time.perf_counter() - t


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeat", type=int, default=2000)
    parser.add_argument("--no-compile", action="store_true", help="leave the compile times out")
    args = parser.parse_args()
    print("median us            predict  update  90 ms late, with its replay")
    for n, on in ((21, []), (27, ["pose_bias"]), (30, ["pose_bias", "lever_arm"])):
        (a, b), c = ours(on, args.repeat), delayed(on, args.repeat)
        p, u = theirs(n, args.repeat)
        print(f"{n} states, ours     {a:7.2f} {b:7.2f} {c:8.1f}")
        print(
            f"{n} states, filterpy {p:7.2f} {u:7.2f} {2 * (p + u):8.1f}  (two predict-update pairs)"
        )
        print(f"   times faster      {p / a:7.1f} {u / b:7.1f} {2 * (p + u) / c:8.1f}")
    if not args.no_compile:
        with tempfile.TemporaryDirectory() as cache:
            cold, warm = seconds_to_first_result(cache), seconds_to_first_result(cache)
        print(
            f"a fresh process to its first fused pose: {cold:.1f} s cold, {warm:.1f} s from cache"
        )


if __name__ == "__main__":
    main()
