"""Set-ups that contradict themselves, as edits of a log; and a run judged by its states."""

from dataclasses import dataclass

import numpy as np
import yaml

from tagvo import geometry as geo
from vio.localize.localizer import Localizer
from vio.localize.run import run
from vio.setup_check.watch import SetupWatch
from vio.sources.flight_log.log import FlightLog


def edit_imu(log, change):
    """Every IMU row of a log through change(t_ns, six) -> (t_ns, six)."""
    file = log / "mav0/imu0/data.csv"
    head, *rows = file.read_text().splitlines()
    out = [head]
    for row in rows:
        cells = row.split(",")
        t_ns, six = change(int(cells[0]), np.array([float(c) for c in cells[1:7]]))
        out.append(",".join([str(t_ns), *(repr(float(v)) for v in six), *cells[7:]]))
    file.write_text("\n".join(out) + "\n")


def turn_camera(log, axis, deg):
    """T_cam_imu turned about an axis of the IMU."""
    file = log / "camchain-imucam.yaml"
    chain = yaml.safe_load(file.read_text())
    T = np.array(chain["cam0"]["T_cam_imu"])
    T[:3, :3] = T[:3, :3] @ geo.exp(np.radians(deg) * np.array(axis, dtype=float))
    chain["cam0"]["T_cam_imu"] = T.tolist()
    file.write_text(yaml.safe_dump(chain))


def size_kind_total(log):
    """The map's sizes taken for those of whole printed tags."""
    file = log / "tagmap.yaml"
    file.write_text(file.read_text().replace("size_kind: border", "size_kind: total"))


FRD = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
GROSS = {
    "accelerometer sign": lambda log: edit_imu(log, lambda t, v: (t, np.r_[v[:3], -v[3:]])),
    "IMU in FRD": lambda log: edit_imu(log, lambda t, v: (t, v * FRD)),
    "T_cam_imu turned 180": lambda log: turn_camera(log, [0, 0, 1], 180.0),
    "T_cam_imu turned 90": lambda log: turn_camera(log, [0, 0, 1], 90.0),
    "IMU 0.3 s late": lambda log: edit_imu(log, lambda t, v: (t + 300_000_000, v)),
    "x and y swapped": lambda log: edit_imu(log, lambda t, v: (t, v[[1, 0, 2, 4, 3, 5]])),
    "gyro z sign": lambda log: edit_imu(log, lambda t, v: (t, v * [1, 1, -1, 1, 1, 1])),
    "size_kind total": size_kind_total,
}
CODES = {
    "accelerometer sign": {"gravity"},
    "IMU in FRD": {"gravity", "imu_axes"},
    "T_cam_imu turned 180": {"cam_imu_rotation"},
    "T_cam_imu turned 90": {"cam_imu_rotation"},
    "IMU 0.3 s late": {"time_offset"},
    "x and y swapped": {"imu_axes"},
    "gyro z sign": {"imu_axes"},
    "size_kind total": {"size_kind"},
    "T_cam_imu tilted 10": {"gravity", "cam_imu_rotation"},
}


def tilt_10(log):
    """T_cam_imu tilted by 10 degrees: more than a calibration error, no blunder."""
    turn_camera(log, [1, 0, 0], 10.0)


@dataclass(frozen=True)
class Judged:
    """findings of the set-up check; share of samples in TRACKING; NEES per dof there; resets."""

    findings: list
    tracking: float
    nees: float
    resets: int
    noise_words: str | None


def judge(folder, force=True):
    """A log through tagvo, the filter and the set-up check; NEES of what is called TRACKING."""
    log = FlightLog.open(folder, use_detections=True)
    with_imu = log.imu is not None
    localizer = Localizer(log.camera, log.tag_map, imu_noise=log.imu_noise, imu=with_imu)
    watch, errors, states = SetupWatch(log.camera, log.tag_map), [], []
    truth = log.truth

    class Keep:
        def event(self, event):
            watch.event(event)

        def output(self, name, out):
            if name != "vio":
                return
            state = localizer.filter.health().state.value
            states.append(state)
            if state != "TRACKING" or len(states) % 4:
                return
            i = int(np.searchsorted(truth.t_ns, out.t_ns))
            if i < len(truth) and abs(int(truth.t_ns[i]) - out.t_ns) < 3_000_000:
                R = geo.matrix_from_quat(truth.q_WI[i])
                errors.append(
                    (np.r_[out.p_WI - truth.p_WI[i], geo.log(R.T @ out.R_WI)], out.cov[:6, :6])
                )

    watch = watch if with_imu else SetupWatch(log.camera, log.tag_map, with_imu=False)
    run(log.events(), localizer, sinks=[Keep()], look=watch.look,
        stop=lambda: watch.certain and not force)  # fmt: skip
    watch.settle()
    nees = [float(e @ np.linalg.solve(P, e)) / 6.0 for e, P in errors]
    states, core = localizer.states, localizer.filter
    return Judged(
        watch.findings, states["TRACKING"] / max(sum(states.values()), 1),
        float(np.mean(nees)) if nees else 0.0, core.health().resets if core else 0,
        core.noise_words if core else None,
    )  # fmt: skip


__all__ = ["CODES", "GROSS", "Judged", "edit_imu", "judge", "tilt_10", "turn_camera"]
