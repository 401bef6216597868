"""The autopilot's own estimate as a trajectory of I in the map: the estimator `fc`."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array, IntArray
from vio.evaluate.records import Trajectory
from vio.frames import FLIP

_NEAR_NS = 100_000_000  # between an attitude and the next, around a position


@dataclass(frozen=True, slots=True, eq=False)
class Said:
    """A LOCAL_POSITION_NED or ATTITUDE: stamp [ns] in the autopilot's clock, arrival in ours, its
    three or six numbers (position and velocity, or roll, pitch, yaw)."""

    stamp_ns: int
    arrival_ns: int
    numbers: tuple[float, ...]


def offset_ns(rows: Sequence[Said]) -> int:
    """Ours minus the autopilot's clock: in lock step both are one, so the least delay is it.

    It is late by what a message takes at least, a step or two, and early by up to a millisecond
    that the stamps are cut to.
    """
    return min(row.arrival_ns - row.stamp_ns for row in rows)


@dataclass(frozen=True, slots=True, eq=False)
class Sent:
    """R_NW (3, 3) by which our poses were sent from since_ns on: it moves when we level anew."""

    since_ns: int
    R_NW: Array


def fc_trajectory(
    positions: Sequence[Said],
    attitudes: Sequence[Said],
    sent: Sequence[Sent],
    R_NW: Array,
    R_BI: Array,
) -> Trajectory:
    """`fc`: the body, which is put at I, as I in W; rows without an attitude near them fall out.

    It is judged from the first pose sent on: before, the autopilot had no place in the map.
    Positions are brought back as ours were sent, for the autopilot took them from us; attitudes by
    R_NW, true to gravity, for that it knows by itself.
    """
    if sent:
        positions = [row for row in positions if row.arrival_ns >= sent[0].since_ns]
    if not positions or len(attitudes) < 2:
        return _trajectory(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 6)),
                           np.zeros((0, 3, 3)))  # fmt: skip
    shift = offset_ns([*positions, *attitudes])
    p, angles = _ascending(positions), _ascending(attitudes)
    stamps = np.array([row.stamp_ns for row in p], dtype=np.int64)
    at = np.array([row.stamp_ns for row in angles], dtype=np.int64)
    right = np.clip(np.searchsorted(at, stamps), 1, len(at) - 1)
    near = (stamps >= at[0]) & (stamps <= at[-1]) & (at[right] - at[right - 1] <= _NEAR_NS)
    rpy = np.array([row.numbers[:3] for row in angles])
    R_NF = geo.matrix_from_rpy(rpy[:, 0], rpy[:, 1], rpy[:, 2])
    before, after = R_NF[right - 1], R_NF[right]
    share = ((stamps - at[right - 1]) / np.maximum(at[right] - at[right - 1], 1))[:, None]
    R = before @ geo.exp(share * geo.log(np.swapaxes(before, -1, -2) @ after))
    R_WI = R_NW.T @ (R * FLIP) @ R_BI
    numbers = np.array([row.numbers for row in p])
    known = np.array([row.arrival_ns for row in p], dtype=np.int64)
    since = [one.since_ns for one in sent[1:]]
    frames = np.array([one.R_NW for one in sent] or [R_NW])[np.searchsorted(since, known, "right")]
    numbers = np.einsum("nki,njk->nji", frames, numbers.reshape(-1, 2, 3)).reshape(-1, 6)
    return _trajectory((stamps + shift)[near], known[near], numbers[near], R_WI[near])


def _ascending(rows: Sequence[Said]) -> list[Said]:
    """In the order of their stamps, a stamp once."""
    return list({row.stamp_ns: row for row in sorted(rows, key=lambda r: r.stamp_ns)}.values())


def _trajectory(t_ns: IntArray, known_ns: IntArray, numbers: Array, R_WI: Array) -> Trajectory:
    return Trajectory("fc", t_ns, known_ns, numbers[:, :3], R_WI, numbers[:, 3:6])
