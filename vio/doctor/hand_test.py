"""Names a wrong axis: what a vehicle moved by hand says of itself, against what was done to it.

The hand lifts it, carries it ahead, turns it clockwise by a quarter, carries it ahead again. Both
carries together tell the sense of turning of positions apart from that of yaw, at any heading: one
carry alone cannot tell a wrong yaw from a wrong axis, and at heading 0 some faults do not show.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from tagvo.geometry import Array
from vio.doctor.records import Finding, Severity

_LEAST_M, _LEAST_RAD = 0.12, np.radians(30.0)  # of a movement that tells anything
_STILL_M = 0.05  # by how much positions may spread at rest
_ALONG = 0.7  # share of a lift that must be vertical
_STRAIGHT = np.radians(35.0)  # how crooked a hand carries
_ENOUGH = 5  # samples at rest


class Step(StrEnum):
    """Where the vehicle rests, in order."""

    START = "start"
    LIFTED = "lifted"
    AHEAD = "ahead"
    TURNED = "turned"
    AGAIN = "again"


ORDERS = {
    Step.START: "Put the vehicle down with room ahead of it, tags in view.",
    Step.LIFTED: "Lift it by 30 to 50 cm, level.",
    Step.AHEAD: "Carry it straight ahead, along its nose, by about half a metre.",
    Step.TURNED: "Turn it on the spot by a quarter turn clockwise, seen from above.",
    Step.AGAIN: "Carry it straight ahead again, along its nose, by about half a metre.",
}


@dataclass(frozen=True, slots=True, eq=False)
class Rest:
    """A pose at rest: p (3,) [m] as sent or reported (should be north, east, down), yaw [rad]."""

    p: Array
    yaw: float


def rest(p: Array, yaw: Array) -> Rest | None:
    """The mean of samples p (n, 3), yaw (m,) while held still; None: too few, or it moved."""
    if len(p) < _ENOUGH or len(yaw) < _ENOUGH or p.std(axis=0).max() > _STILL_M:
        return None
    return Rest(p.mean(axis=0), float(np.angle(np.exp(1j * yaw).mean())))


def judge(who: str, rests: Mapping[Step, Rest | None]) -> list[Finding]:
    """What is wrong with the axes of one source, from its rests at every step."""
    known = {step: one for step, one in rests.items() if one is not None}
    lost = [step for step in Step if step not in known]
    if lost:
        return [_again(who, f"no still pose at: {', '.join(lost)}")]
    found, z_up = _lift(who, known[Step.LIFTED].p - known[Step.START].p)
    return found + _level(who, known, z_up)


def _again(who: str, why: str) -> Finding:
    return Finding(
        Severity.ERROR,
        "wiggle_again",
        f"{who}: the axes could not be judged",
        why,
        "do it again, with larger and straighter movements",
    )


def _wrong(who: str, code: str, what: str, why: str, do: str) -> Finding:
    return Finding(Severity.ERROR, code, f"{who}: {what}", why, do)


def _lift(who: str, moved: Array) -> tuple[list[Finding], bool]:
    """The vertical axis: z must fall; and whether it grew instead."""
    length = float(np.linalg.norm(moved))
    if length < _LEAST_M:
        return [_again(who, f"the lift was {length * 100:.0f} cm")], False
    if abs(moved[2]) < _ALONG * length:
        axis = "xy"[int(np.argmax(np.abs(moved[:2])))]
        return [
            _wrong(
                who,
                "axis_vertical",
                f"lifted, {axis} moved and z hardly did",
                "the frame is not level: gravity is looked for along a wrong axis",
                "check the map's orientation and vehicle.T_BI",
            )
        ], False
    if moved[2] > 0.0:
        return [
            _wrong(
                who,
                "axis_z",
                "lifted, z grew: it points up",
                "flight controllers want down: the vehicle would climb away",
                "negate z (a z-up frame was sent as NED)",
            )
        ], True
    return [], False


def _level(who: str, at: Mapping[Step, Rest], z_up: bool) -> list[Finding]:
    """The horizontal axes and yaw, from both carries and the turn between."""
    first = at[Step.AHEAD].p[:2] - at[Step.LIFTED].p[:2]
    second = at[Step.AGAIN].p[:2] - at[Step.TURNED].p[:2]
    short = min(float(np.hypot(*first)), float(np.hypot(*second)))
    if short < _LEAST_M:
        return [_again(who, f"a carry was {short * 100:.0f} cm in the plane")]
    ways = np.array([np.arctan2(d[1], d[0]) for d in (first, second)])
    yaws = np.array([at[Step.AHEAD].yaw, at[Step.TURNED].yaw])
    turned_p, turned_yaw = _wrap(ways[1] - ways[0]), _wrap(yaws[1] - yaws[0])
    if min(abs(turned_p), abs(turned_yaw)) < _LEAST_RAD:
        return [
            _again(
                who,
                f"turned, positions turned by {np.degrees(turned_p):.0f} and yaw by"
                f" {np.degrees(turned_yaw):.0f} deg",
            )
        ]
    mirrored, backward = turned_p < 0.0, turned_yaw < 0.0
    # with both senses alike the nose's heading is the carry's plus a constant, else minus it
    sums = ways - yaws if mirrored == backward else ways + yaws
    if abs(_wrap(sums[1] - sums[0])) > 2.0 * _STRAIGHT:
        return [_again(who, "the two carries contradict each other")]
    off = float(np.angle(np.exp(1j * sums).mean()))
    if mirrored and backward:
        return [_frame(who, z_up), *_nose(who, off)]
    if mirrored:
        return [_axis(who, off)]
    return [_yaw(who, off)] if backward else _nose(who, off)


def _wrap(angle: float) -> float:
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _frame(who: str, z_up: bool) -> Finding:
    frame = "a z-up frame (ENU or FLU) was sent as NED" if z_up else "left and right are exchanged"
    return _wrong(
        who,
        "axis_mirrored",
        "turned clockwise, positions and yaw turned the other way",
        f"the whole horizontal frame is mirrored: {frame}; it flies until the first turn",
        "convert to NED: negate y, z, pitch and yaw",
    )


def _axis(who: str, off: float) -> Finding:
    """Positions mirrored, yaw right: heading of the carry plus yaw says which axis."""
    quarter = round(off / (np.pi / 2)) % 4
    what, do = {
        0: ("y has the wrong sign", "negate y: east is positive"),
        1: ("x and y are exchanged", "exchange x and y (ENU was sent as NED)"),
        2: ("x has the wrong sign", "negate x: north is positive"),
        3: ("x and y are exchanged and negated", "exchange x and y, negate both"),
    }[quarter]
    why = "turned clockwise, positions turned the other way: the vehicle flies away at a turn"
    return _wrong(who, "axis_xy", what, why, do)


def _yaw(who: str, off: float) -> Finding:
    east = round(off / (np.pi / 2)) % 4 == 1
    what = "yaw falls when turned clockwise" + (" and counts from east" if east else "")
    return _wrong(
        who,
        "axis_yaw",
        what,
        "it flies at heading 0 and away at any other: 27 m in a test at 60 deg",
        "send pi/2 - yaw (ENU was sent)" if east else "negate yaw",
    )


def _nose(who: str, off: float) -> list[Finding]:
    """Both senses alike: the carry must lie along the yaw."""
    if abs(off) < _STRAIGHT:
        return []
    degrees = np.degrees(off)
    return [
        _wrong(
            who,
            "axis_nose",
            f"carried along its nose, it moved {degrees:+.0f} deg off its yaw",
            "the nose is not where yaw says: commands to go ahead go elsewhere",
            "check vehicle.T_BI (the IMU in the body), the camera's T_cam_imu and which way"
            " the nose is",
        )
    ]
