"""Recorded companion links through the live IMU source: its stamps against two-sided references.

For tests/vio/mavlink/test_mavlink_clock_recorded.py and tools/clock_study.py.
"""

import struct
from dataclasses import dataclass

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as m

from vio.config.mavlink import MavlinkConfig
from vio.mavlink.codec import MESSAGE_IDS
from vio.mavlink.protocol import Companion
from vio.sources.live.imu import MavlinkImu

WANTED = {m.MAVLINK_MSG_ID_HEARTBEAT, m.MAVLINK_MSG_ID_TIMESYNC, m.MAVLINK_MSG_ID_HIGHRES_IMU}
HALF_LINE_NS = 5_000_000_000  # a line of 10 s about each stamp
SETTLE_NS = 20_000_000_000


def read_tlog(path):
    """(stamp [ns], message) of every wanted message; frames cut by their own lengths."""
    data, parser, at = path.read_bytes(), m.MAVLink(None), 0
    while at + 20 < len(data):
        (stamp_us,) = struct.unpack(">Q", data[at : at + 8])
        assert data[at + 8] == 0xFD, f"{path} byte {at}: no MAVLink 2 frame"
        size = 12 + data[at + 9] + (13 if data[at + 10] & 1 else 0)
        number = int.from_bytes(data[at + 15 : at + 18], "little")
        if number in WANTED:
            yield stamp_us * 1000, parser.decode(bytearray(data[at + 8 : at + 8 + size]))
        at += 8 + size


@dataclass(frozen=True)
class Study:
    """Stamps [ns] of the autopilot and what they became, with their arrivals; all exchanges."""

    name: str
    their: np.ndarray  # (n,)
    ours: np.ndarray  # (n,)
    arrival: np.ndarray  # (n,)
    exchange: np.ndarray  # (k, 3): sent, heard, theirs
    counters: dict
    epochs: int

    @property
    def middle(self):
        """Ours minus theirs at each exchange [ns], had both ways taken equally long; (k,)."""
        return (self.exchange[:, 0] + self.exchange[:, 1]) // 2 - self.exchange[:, 2]

    @property
    def judged(self):
        """Samples 20 s after the first exchange that have half a line after them."""
        first, last = self.exchange[0, 1], self.exchange[-1, 1]
        return (self.arrival > first + SETTLE_NS) & (self.arrival < last - HALF_LINE_NS)

    def line(self):
        """Offset [ms] by a least-squares line through all middles within 5 s of each stamp."""
        base, theirs = int(self.middle[0]), self.exchange[:, 2]
        y = (self.middle - base) * 1e-6
        out = []
        for stamp in self.their[self.judged][::10]:
            near = np.abs(theirs - stamp) <= HALF_LINE_NS
            x = (theirs[near] - stamp) * 1e-9
            out.append(np.polyfit(x, y[near], 1)[1])
        return np.array(out)

    def between(self):
        """Offset [ms] by the middles on both sides of each stamp, outliers out (median of 5)."""
        base = int(self.middle[0])
        y = (self.middle - base) * 1e-6
        padded = np.pad(y, 2, mode="edge")
        y = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
        stamps = self.their[self.judged][::10]
        return np.interp(stamps.astype(float), self.exchange[:, 2].astype(float), y)

    def causal(self):
        """Offset [ms] that each stamp was given when it came."""
        offset = self.ours - self.their - int(self.middle[0])
        return offset[self.judged][::10] * 1e-6


def play(path):
    """A recorded link through Companion and MavlinkImu, as if it were live."""
    config = MavlinkConfig.model_validate({"origin": None})
    companion = Companion(config, np.eye(3), np.zeros(3), 1, MESSAGE_IDS)
    rows, exchanges, asked = [], [], {}
    imu = MavlinkImu(companion, np.eye(3), lambda sample: rows.append((sample.t_ns, their)))
    arrivals = []
    for stamp, message in read_tlog(path):
        kind = message.get_type()
        if message.get_srcComponent() == 197:
            if kind == "TIMESYNC" and message.tc1 == 0:
                asked[companion.asker.ask(message.ts1)] = True
            continue
        if kind == "TIMESYNC" and message.tc1 and asked.pop(message.ts1, False):
            exchanges.append((message.ts1, stamp, message.tc1))
        companion.heard(message, stamp)
        if kind == "HIGHRES_IMU":
            their, count = message.time_usec * 1000, len(rows)
            imu.heard(message, stamp)
            arrivals += [stamp] * (len(rows) - count)
    ours, theirs = np.array(rows).T
    return Study(path.stem, theirs, ours, np.array(arrivals), np.array(exchanges),
                 dict(imu.counters), companion.clock.epoch)  # fmt: skip


def lag_ms(folder):
    """By how much the gyro of HIGHRES_IMU lies behind the log's own, in the autopilot's clock.

    The shift [ms] with the smallest squared difference, both on a grid of 1 ms, to 0.1 ms.
    """
    raw, link = (np.loadtxt(folder / "mav0" / name / "data.csv", delimiter=",", comments="#")
                 for name in ("imu0", "imu_mavlink"))  # fmt: skip
    first, last = max(raw[0, 0], link[0, 0]), min(raw[-1, 0], link[-1, 0])
    grid = np.arange(first + 1e8, last - 1e8, 1e6)
    shifts = np.arange(-5.0, 20.0, 0.5)
    cost = []
    for shift in shifts:
        difference = 0.0
        for axis in (1, 2, 3):
            a = np.interp(grid - shift * 1e6, raw[:, 0], raw[:, axis])
            b = np.interp(grid, link[:, 0], link[:, axis])
            difference += np.mean(np.square(a - b))
        cost.append(difference)
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    a, b, c = cost[k - 1 : k + 2]
    return float(shifts[k] + 0.25 * (a - c) / (a - 2 * b + c))


def quantiles(error):
    """Median, 95th percentile and maximum of absolute errors."""
    return np.percentile(np.abs(error), [50, 95, 100])
