"""What is in each message that leaves: pure functions from states to fields, without a link."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.filter.health import Health, State
from vio.frames import NedPose, body_velocity, euler_321, triangle

LOCAL_NED, BODY_FRD, LOCAL_FRD = 1, 12, 20  # MAV_FRAME
ARDUPILOT, PX4, NO_AUTOPILOT = 3, 12, 8  # MAV_AUTOPILOT
ONBOARD_CONTROLLER = 18  # MAV_TYPE
BOOT, ACTIVE, CRITICAL, TERMINATION = 1, 4, 5, 8  # MAV_STATE
ERROR, WARNING, INFO = 3, 4, 6  # MAV_SEVERITY
VIO_ESTIMATOR = 3  # MAV_ESTIMATOR_TYPE
SET_MESSAGE_INTERVAL, REQUEST_MESSAGE = 511, 512  # MAV_CMD
GPS_GLOBAL_ORIGIN_ID = 49
AUTOPILOT_COMPONENT = 1
_TEXT = 50  # bytes of one STATUSTEXT
_NAN = float("nan")
_QUALITY = {State.TRACKING: 100, State.COASTING: 30, State.RELOCATING: 10}


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One message to send: its MAVLink name and all its fields; t_ns: when a pose holds."""

    name: str
    fields: dict[str, Any]
    t_ns: int | None = None


def vision_position_estimate(t_ns: int, pose: NedPose, counter: int) -> Outgoing:
    """VISION_POSITION_ESTIMATE of a body in N, valid at t_ns of the one monotonic clock."""
    x, y, z = pose.p_NB.tolist()
    roll, pitch, yaw = euler_321(pose.R_NF).tolist()
    return Outgoing(
        "VISION_POSITION_ESTIMATE",
        {
            "usec": t_ns // 1000,
            "x": x, "y": y, "z": z,
            "roll": roll, "pitch": pitch, "yaw": yaw,
            "covariance": triangle(pose.cov),
            "reset_counter": counter,
        },
        t_ns,
    )  # fmt: skip


def vision_speed_estimate(t_ns: int, pose: NedPose, counter: int) -> Outgoing | None:
    """VISION_SPEED_ESTIMATE in N; None where the velocity is not known."""
    if pose.v_NB is None:
        return None
    x, y, z = pose.v_NB.tolist()
    cov = None if pose.cov is None or len(pose.cov) < 9 else pose.cov[6:, 6:]
    finite = cov is not None and np.isfinite(cov).all()
    covariance = cov.ravel().tolist() if finite and cov is not None else [_NAN] * 9
    return Outgoing(
        "VISION_SPEED_ESTIMATE",
        {"usec": t_ns // 1000, "x": x, "y": y, "z": z,
         "covariance": covariance, "reset_counter": counter},
        t_ns,
    )  # fmt: skip


def odometry(t_ns: int, pose: NedPose, counter: int, frame_id: int, quality: int) -> Outgoing:
    """ODOMETRY: pose in N, velocity and angular rate in F; what is not known is NaN."""
    x, y, z = pose.p_NB.tolist()
    moving = body_velocity(pose)
    vx, vy, vz = [_NAN] * 3 if moving is None else moving[0].tolist()
    rates = [_NAN] * 3 if pose.w_F is None else pose.w_F.tolist()
    return Outgoing(
        "ODOMETRY",
        {
            "time_usec": t_ns // 1000,
            "frame_id": frame_id, "child_frame_id": BODY_FRD,
            "x": x, "y": y, "z": z,
            "q": geo.quat_from_matrix(pose.R_NF).tolist(),
            "vx": vx, "vy": vy, "vz": vz,
            "rollspeed": rates[0], "pitchspeed": rates[1], "yawspeed": rates[2],
            "pose_covariance": triangle(pose.cov),
            "velocity_covariance": _velocity_triangle(None if moving is None else moving[1]),
            "reset_counter": counter,
            "estimator_type": VIO_ESTIMATOR,
            "quality": quality,
        },
        t_ns,
    )  # fmt: skip


def _velocity_triangle(cov: Array | None) -> list[float]:
    """21 elements: the linear part where it is known; that of the angular rates never is."""
    if cov is None:
        return triangle(None)
    six = np.full((6, 6), np.nan)
    six[:3, :3] = cov
    linear = triangle(cov, 3)
    return six[np.triu_indices(6)].tolist() if np.isfinite(linear).all() else triangle(None)


def odometry_frame(autopilot: int) -> int:
    """frame_id that this autopilot takes: ArduPilot 20 alone; PX4 cannot be armed with 20."""
    return LOCAL_FRD if autopilot == ARDUPILOT else LOCAL_NED


def quality(health: Health) -> int:
    """ODOMETRY's quality [%]; 0 would mean unknown, -1 failed."""
    return _QUALITY.get(health.state, -1)


def heartbeat(system_status: int) -> Outgoing:
    """HEARTBEAT of an onboard controller that is no autopilot."""
    fields = {"type": ONBOARD_CONTROLLER, "autopilot": NO_AUTOPILOT, "base_mode": 0}
    fields |= {"custom_mode": 0, "system_status": system_status, "mavlink_version": 3}
    return Outgoing("HEARTBEAT", fields)


def system_status(health: Health | None, alarmed: bool = False) -> int:
    """MAV_STATE for the heartbeat; None: nothing has been heard of the filter yet.

    alarmed: critical, but for a filter that is lost, which is worse.
    """
    if alarmed and (health is None or health.state is not State.LOST):
        return CRITICAL
    if health is None or health.state is State.INIT:
        return BOOT
    if health.state is State.TRACKING:
        return ACTIVE
    return TERMINATION if health.state is State.LOST else CRITICAL


def statustext(text: str, severity: int, text_id: int) -> list[Outgoing]:
    """STATUSTEXT in chunks of 50 bytes; text_id (1..65535) ties them together."""
    raw = text.encode("ascii", errors="replace")
    whole = len(raw) <= _TEXT
    # a chunk that is not full ends the text: one that fills its last chunk needs an empty one
    pieces = [raw] if whole else [raw[i : i + _TEXT] for i in range(0, len(raw) + 1, _TEXT)]
    return [
        Outgoing(
            "STATUSTEXT",
            {"severity": severity, "text": piece, "id": 0 if whole else text_id, "chunk_seq": k},
        )
        for k, piece in enumerate(pieces)
    ]


def timesync(their_ns: int, our_ns: int) -> Outgoing:
    """TIMESYNC: tc1 = our_ns, 0 in a request; ts1 mirrors the asker's stamp."""
    return Outgoing("TIMESYNC", {"tc1": our_ns, "ts1": their_ns})


def set_gps_global_origin(system: int, lat_deg: float, lon_deg: float, alt_m: float) -> Outgoing:
    """SET_GPS_GLOBAL_ORIGIN; its time is left unknown."""
    fields = {"target_system": system, "latitude": round(lat_deg * 1e7)}
    fields |= {"longitude": round(lon_deg * 1e7), "altitude": round(alt_m * 1e3), "time_usec": 0}
    return Outgoing("SET_GPS_GLOBAL_ORIGIN", fields)


def command(system: int, number: int, *params: float) -> Outgoing:
    """COMMAND_LONG to the autopilot of a system; missing parameters are 0."""
    values = [*params, *([0.0] * (7 - len(params)))]
    fields = {"target_system": system, "target_component": AUTOPILOT_COMPONENT}
    fields |= {"command": number, "confirmation": 0}
    return Outgoing("COMMAND_LONG", fields | {f"param{k + 1}": v for k, v in enumerate(values)})
