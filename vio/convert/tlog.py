"""A recorded MAVLink link (.tlog): the IMU as the companion computer had it."""

from pathlib import Path
from typing import Any

import numpy as np

from vio.convert.records import Foreign, said
from vio.errors import LogError
from vio.frames import FLIP
from vio.records import ImuTrack
from vio.sources.flight_log.tally import Tally
from vio.sources.live.imu import body_frd, unwrapped

NAME = "imu_mavlink"
_MESSAGES = ("HIGHRES_IMU", "RAW_IMU", "SCALED_IMU")  # the first that is there is taken
_AUTOPILOT = 1  # MAV_COMP_ID_AUTOPILOT1
_PX4 = 12
_LATEST_NS = 2**62  # differences of stamps must fit in int64
_OTHER = 8  # MAV_AUTOPILOT_INVALID


def read_tlog(path: Path, tally: Tally) -> Foreign:
    """The finest IMU message of the link in FLU, with its arrivals in the companion's clock.

    Stamps are the autopilot's time since boot. LogError where the file is none or has no IMU.
    """
    rows: dict[str, list[tuple[int, int, Any]]] = {name: [] for name in _MESSAGES}
    autopilot = None
    for message, known_ns in _messages(path, tally):
        name = message.get_type()
        if name == "HEARTBEAT":
            autopilot = message.autopilot if message.autopilot != _OTHER else autopilot
            continue
        gyro_F, accel_F, t_ns = body_frd(message)
        if not (0 <= t_ns < _LATEST_NS and 0 <= known_ns < _LATEST_NS):
            tally.count("tlog_stamp", f"{path}: a {name} stamped {t_ns} ns, heard at {known_ns} ns")
            continue
        if name == "SCALED_IMU":
            t_ns = unwrapped(t_ns, rows[name][-1][0]) if rows[name] else t_ns
        rows[name].append((t_ns, known_ns, np.concatenate([gyro_F * FLIP, accel_F * FLIP])))
    taken = next((name for name in _MESSAGES if rows[name]), None)
    if taken is None:
        raise LogError(f"{path}: no IMU in it; one of {', '.join(_MESSAGES)} is needed")
    values = np.stack([row[2] for row in rows[taken]])
    stamps = np.array([row[0] for row in rows[taken]], dtype=np.int64)
    known_ns = np.array([row[1] for row in rows[taken]], dtype=np.int64)
    mean = (
        np.ones(len(stamps), dtype=np.bool_)
        if autopilot == _PX4 and taken == _MESSAGES[0]
        else None
    )
    track = ImuTrack(stamps, values[:, :3], values[:, 3:], stamps, mean)
    note = f"{path}: {taken} of the link is mav0/{NAME}; stamps in the autopilot's clock"
    return Foreign({NAME: track}, {NAME: known_ns}, notes=(note,))


def _next(link: Any, path: Path, tally: Tally) -> Any:
    try:
        return link.recv_msg()
    except Exception as err:  # whatever a broken file makes of pymavlink
        tally.count("tlog_broken", f"{path}: reading ends where it is broken ({said(err)})")
        return None


def _messages(path: Path, tally: Tally) -> Any:
    """Messages of the autopilot's own with the moment [ns] that each was heard."""
    from pymavlink import mavutil

    try:
        link = mavutil.mavlogfile(str(path), robust_parsing=True)
    except Exception as err:  # whatever a broken file makes of pymavlink
        raise LogError(f"{path}: not a MAVLink log that can be read ({said(err)})") from None
    wanted = {*_MESSAGES, "HEARTBEAT"}
    try:
        while (message := _next(link, path, tally)) is not None:
            name = message.get_type()
            if name == "BAD_DATA":
                tally.count("tlog_broken", f"{path}: bytes that are no message")
            elif name in wanted and message.get_srcComponent() == _AUTOPILOT:
                yield message, round(message._timestamp * 1e6) * 1000
    finally:
        link.close()
