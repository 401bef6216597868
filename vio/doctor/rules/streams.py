"""Rules on what flows and what the autopilot says: its IMU, its filter, its origin, poses."""

from collections.abc import Callable

from vio.doctor.records import Facts, Finding, Severity
from vio.mavlink.messages import ARDUPILOT, BODY_FRD, LOCAL_FRD, PX4
from vio.sources.live.imu import trap

E, W, I = Severity.ERROR, Severity.WARNING, Severity.INFO  # noqa: E741
_SHORT = 0.9  # of the rate that is needed
_SLOWEST_HZ, _FASTEST_HZ = 10.0, 50.0
_VELOCITY, _RELATIVE, _ABSOLUTE, _HEIGHT, _CONST = 2, 8, 16, 32, 128  # of both status messages
_TEXTS = {
    "waiting for home": "ArduPilot has no origin: mavlink.origin must not be null, and vision must"
    " come after it",
    "need position estimate": "EKF3 has no position: vision does not arrive or is not used",
    "visodom": "vision does not arrive, or by gaps of more than 0.3 s",
    "heading estimate not stable": "PX4 denies arming while ODOMETRY comes in LOCAL_FRD (20): the"
    " sender must use LOCAL_NED (1), as ours does",
    "ekf variance": "the EKF has lost its position",
}


def imu(f: Facts) -> list[Finding]:
    """The stream that the filter needs."""
    name, needed = f.config.imu.message, f.config.imu.rate_hz
    if f.imu_hz is None or not f.alive:
        return []
    known = trap(f.autopilot, name)
    out = [] if known is None else [Finding(I, "imu_trap", f"{name} has its traps", known)]
    if f.imu_hz < 0.1:
        return [
            Finding(
                E,
                "imu_missing",
                f"{name} does not come",
                "the filter flies on it",
                known or "look at the rates of this port",
            ),
            *out,
        ]
    if f.imu_hz < _SHORT * needed:
        px4 = "; PX4 sends every sample of its IMU or every second one: 200 Hz give 123"
        why = "the filter needs it" + (px4 if f.autopilot == PX4 else "")
        do = "raise the link (MAV_x_RATE, baud)" if f.autopilot == PX4 else "raise the baud rate"
        out.insert(
            0,
            Finding(
                W,
                "imu_slow",
                f"{name} comes at {f.imu_hz:.0f} Hz, {needed:g} are needed",
                why,
                f"{do}, or lower mavlink.imu.rate_hz",
            ),
        )
    return out


def belief(f: Facts) -> list[Finding]:
    """The autopilot's own position and yaw against the poses on the link."""
    if f.belief is None:
        return []
    yaw = "EK3_SRC1_YAW 6" if f.autopilot == ARDUPILOT else "EKF2_EV_CTRL with yaw (8)"
    return [
        Finding(
            E,
            "belief",
            f"the {f.belief}",
            "it does not fly by what it is sent: it would go elsewhere, or away",
            f"yaw: {yaw}, compass off, or mavlink.map_heading_deg; position: another origin was set"
            " (a ground station?), or another source is fused; GPS by intent: mavlink.belief null",
        )
    ]


def filter_flags(f: Facts) -> list[Finding]:
    """What the autopilot's own filter says of itself."""
    if f.ekf_flags is None:
        return [
            Finding(
                I,
                "ekf_unknown",
                "the autopilot's filter says nothing of itself",
                "EKF_STATUS_REPORT or ESTIMATOR_STATUS did not come",
            )
        ]
    flags = f.ekf_flags
    lacks = [
        word
        for bit, word in (
            (_VELOCITY, "velocity"),
            (_RELATIVE | _ABSOLUTE, "position"),
            (_HEIGHT, "height"),
        )
        if not flags & bit
    ]
    if not lacks and not flags & _CONST:
        return []
    text = f"the autopilot's filter has no {', no '.join(lacks or ['aiding'])} (flags {flags})"
    if f.vision is None:
        return [Finding(I, "ekf_waits", text, "no poses are heard on this link")]
    return [
        Finding(
            E,
            "ekf_no_vision",
            text,
            "vision flows and is not used: it cannot be flown",
            "mend the other findings first",
        )
    ]


def origin(f: Facts) -> list[Finding]:
    """The place on earth."""
    ardupilot = f.autopilot == ARDUPILOT
    if not f.origin:
        none = f.config.origin is None
        severity = (E if none else W) if ardupilot else I
        why = (
            (
                "without one it refuses to arm: 'waiting for home'; our daemon sends it before the"
                " first pose"
            )
            if ardupilot
            else "only modes on global positions need it"
        )
        do = "give mavlink.origin a place" if none else ""
        return [Finding(severity, "no_origin", "the autopilot has no origin", why, do)]
    if ardupilot and not f.home:
        return [Finding(I, "no_home", "no home position yet", "ArduPilot sets it when it arms")]
    return []


def texts(f: Facts) -> list[Finding]:
    """What the autopilot says itself."""
    out = []
    for text in dict.fromkeys(f.texts):
        known = next((why for key, why in _TEXTS.items() if key in text.lower()), None)
        if known is not None:
            out.append(Finding(E, "says", f"the autopilot says: {text}", known))
    return out


def vision(f: Facts) -> list[Finding]:
    """Poses that flow, whoever sends them."""
    v = f.vision
    if v is None:
        return []
    out = []
    if v.rate_hz < _SLOWEST_HZ:
        out.append(
            Finding(
                E,
                "vision_slow",
                f"{v.name} comes at {v.rate_hz:.1f} Hz",
                "below 10 Hz ArduPilot calls it not healthy and PX4 does not fuse it",
                "send 20 to 40 a second",
            )
        )
    elif v.rate_hz > _FASTEST_HZ:
        out.append(
            Finding(
                W,
                "vision_fast",
                f"{v.name} comes at {v.rate_hz:.0f} Hz",
                "above 50 Hz ArduPilot drops poses, above 95 PX4 does",
                "send 20 to 40 a second",
            )
        )
    if v.repeats:
        out.append(
            Finding(
                W,
                "vision_repeats",
                f"{v.repeats} poses came twice",
                "an old pose with a new arrival is taken for news",
                "send new poses only",
            )
        )
    if not v.ages_ms:
        severity = E if f.autopilot == PX4 and f.timesync_asked else I
        out.append(
            Finding(
                severity,
                "vision_clock",
                "poses are not stamped in the clock that answers TIMESYNC",
                "PX4 drops all of them once its TIMESYNC has converged, after 50 s",
                "one clock for both: the monotonic one",
            )
        )
    return out + _frames(f, v.frames)


def _frames(f: Facts, frames: frozenset[tuple[int, int]]) -> list[Finding]:
    if f.autopilot == ARDUPILOT and frames - {(LOCAL_FRD, BODY_FRD)}:
        return [
            Finding(
                E,
                "odometry_frame",
                f"ODOMETRY comes in frames {sorted(frames)}",
                "ArduPilot silently drops all but LOCAL_FRD (20) with BODY_FRD (12)",
                "set the sender's frame_id 20 and child_frame_id 12",
            )
        ]
    if f.autopilot == PX4 and any(frame == LOCAL_FRD for frame, _ in frames):
        return [
            Finding(
                E,
                "odometry_frame",
                "ODOMETRY comes in LOCAL_FRD (20)",
                "PX4 fuses it and then denies arming: 'heading estimate not stable'",
                "set the sender's frame_id 1 (LOCAL_NED)",
            )
        ]
    return []


RULES: tuple[Callable[[Facts], list[Finding]], ...] = (
    imu,
    belief,
    filter_flags,
    origin,
    texts,
    vision,
)
