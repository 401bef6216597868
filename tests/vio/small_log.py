"""Writes a small flight log, whole and clean; tests edit copies of it, a fault at a time."""

from pathlib import Path

import cv2
import numpy as np

T0 = 1_403_638_519_492_829_441  # odd: a float cannot hold it
IMU_STEP, FRAME_STEP = 10_000_000, 100_000_000
N_IMU, N_FRAMES = 200, 20
IMU_START = T0 + 50_000_001  # the camera starts before the IMU
WIDTH, HEIGHT = 64, 48
CAMERA = f"""cam0:
  camera_model: pinhole
  intrinsics: [60.0, 60.0, 31.5, 23.5]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.0, 0.0]
  T_cam_imu: [[0, -1, 0, 0.1], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]]
  timeshift_cam_imu: 0.001
  resolution: [{WIDTH}, {HEIGHT}]
"""
TAG_MAP = """family: tag36h11
tags:
  - {id: 3, size: 0.2, p: [0, 0, 0], q: [1, 0, 0, 0]}
  - {id: 7, size: 0.1, p: [0.5, 0, 0], q: [1, 0, 0, 0]}
"""
NOISE = """rostopic: /imu0
update_rate: 100.0
accelerometer_noise_density: 2e-3
accelerometer_random_walk: 3.0e-3
gyroscope_noise_density: 1.7e-04
gyroscope_random_walk: 0
"""
IMU_HEADER = "#timestamp [ns],w_RS_S_x [rad s^-1],w_y,w_z,a_RS_S_x [m s^-2],a_y,a_z [m s^-2]\n"
TRUTH_HEADER = "#timestamp [ns],p_x,p_y,p_z [m],q_w,q_x,q_y,q_z[,v_x,v_y,v_z]\n"
DETECTIONS_HEADER = "#timestamp [ns],tag_id,u_tl,v_tl,u_tr,v_tr,u_br,v_br,u_bl,v_bl [px]\n"
FRAMES_HEADER = "#timestamp [ns],filename\n"

IMU_STAMPS = [IMU_START + i * IMU_STEP for i in range(N_IMU)]
FRAME_STAMPS = [T0 + i * FRAME_STEP for i in range(N_FRAMES)]


def imu_row(i: int) -> str:
    return f"{IMU_STAMPS[i]},{0.001 * i:.6f},0.2,0.3,0.1,{0.01 * i:.6f},9.81\n"


def corner_cells(i: int, tag_id: int) -> str:
    square = np.array([[10, 10], [20, 10], [20, 20], [10, 20]]) + 0.1 * i + 0.01 * tag_id
    return ",".join(f"{x:.3f}" for x in square.ravel())


def write_log(
    root: Path, *, images: bool = True, detections: bool = False, imu: bool = True
) -> Path:
    """A log of 2 s below `root`: frames at 10 Hz, IMU at 100 Hz, truth, phases, noise."""
    log = root / "log"
    cam, truth = log / "mav0/cam0", log / "mav0/state_groundtruth_estimate0"
    cam.mkdir(parents=True)
    truth.mkdir()
    (log / "camchain-imucam.yaml").write_text(CAMERA)
    (log / "tagmap.yaml").write_text(TAG_MAP)
    names = [f"{t},{t}.png\n" for t in FRAME_STAMPS]
    (cam / "data.csv").write_text(FRAMES_HEADER + "".join(names))
    if images:
        (cam / "data").mkdir()
        for i, t in enumerate(FRAME_STAMPS):
            cv2.imwrite(str(cam / "data" / f"{t}.png"), np.full((HEIGHT, WIDTH), i, np.uint8))
    if detections:
        rows = [
            f"{t},{tag},{corner_cells(i, tag)}\n"
            for i, t in enumerate(FRAME_STAMPS)
            for tag in ((3, 7, 99) if i != 5 else ())  # frame 5 saw nothing
        ]
        (cam / "detections.csv").write_text(DETECTIONS_HEADER + "".join(rows))
    if imu:
        (log / "mav0/imu0").mkdir()
        rows = [imu_row(i) for i in range(N_IMU)]
        (log / "mav0/imu0/data.csv").write_text(IMU_HEADER + "".join(rows))
        (log / "imu.yaml").write_text(NOISE)
    rows = [f"{t},{0.1 * i},0,1,1,0,0,0,1,0,0\n" for i, t in enumerate(FRAME_STAMPS)]
    (truth / "data.csv").write_text(TRUTH_HEADER + "".join(rows))
    phases = f"name,t_start_ns,t_end_ns\nall,{T0},{FRAME_STAMPS[-1]}\nleg,{T0},{T0 + 7}\n"
    (log / "phases.csv").write_text(phases)
    return log
