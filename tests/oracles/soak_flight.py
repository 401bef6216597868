"""A long flight of the daemon against an in-test autopilot: is anything lost, does it grow?"""

import json
import os
import sys
import time
from dataclasses import dataclass
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "vio"))

from fc_ardupilot import ArduPilot
from fc_live import Live, free_port, udp_to, until
from still_flight import Daemon, write_config, write_images

VISION = "VISION_POSITION_ESTIMATE"
_TICK = os.sysconf("SC_CLK_TCK")


class Steady(ArduPilot):
    """Its IMU keeps to the rate that was asked for, whenever it is polled; `imu_sent` counts."""

    imu_sent = 0

    def due(self, message_id, t_ns):
        interval = self.streams.get(message_id)
        last = self.sent_at.get(message_id)
        if interval is None or (last is not None and t_ns - last < interval):
            return False
        late = last is None or t_ns - last > 10 * interval
        self.sent_at[message_id] = t_ns if late else last + interval
        self.imu_sent += message_id == 105
        return True


@dataclass
class Soak:
    """What came of it: seconds flown, counts of both ends, RSS by second [MB], share of a core.

    imu_sent, got, fused: the autopilot's counts in that time; imu_total: all samples that it had
    sent a second before the status was written; got_total: all poses that ever came.
    """

    seconds: float
    imu_sent: int
    imu_total: int
    got_total: int
    got: int
    fused: int
    ages_ms: list[float]
    status: dict
    rss_mb: list[float]
    cpu: float

    def lost(self):
        """Everything that was counted as dropped, late or faulty by either end."""
        bad = ("dropped", "skipped", "faults", "not_sent", "camera_lost", "record_stopped",
               "off_clock", "repeated", "refused", "guessed", "imu_gap", "imu_lost", "too_old",
               "over_rate", "link_broken")  # fmt: skip
        counters = self.status["counters"]
        return {k: n for k, n in counters.items() if any(word in k for word in bad)}

    def missing_imu(self):
        """Samples that the autopilot sent and of which the daemon knows nothing."""
        known = self.status["counters"].get("imu_clock_unknown", 0)
        return max(0, self.imu_total - self.status["counts"]["imu"] - known)

    def missing_poses(self):
        """Poses that the daemon sent and the autopilot never got."""
        return max(0, self.status["counts"]["messages"] - self.got_total)

    def growth_mb(self, after_s):
        """Mean RSS of the last tenth minus that of as long from after_s on."""
        n = max(1, len(self.rss_mb) // 10)
        start = self.rss_mb[after_s : after_s + n]
        return sum(self.rss_mb[-n:]) / n - sum(start) / len(start)


def rss_mb(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def soak(folder, seconds, *, rate_hz=30.0, core=None, words=(), each_second=lambda k, daemon: None):
    """Fly for so long from the first pose on; folder: empty, for images and recording.

    core: the daemon has this one alone, with all its threads; None: it runs where it likes.
    words: more of its command line.
    """
    port = free_port()
    write_images(folder / "images")
    config = write_config(folder, port, rate_hz=rate_hz)
    rss = []
    pinned = () if core is None else ("taskset", "-c", str(core))
    with Live(udp_to(port), Steady) as live, Daemon(config, *words, before=pinned) as daemon:
        until(lambda: live.fc.heard.get(VISION), 120.0, "vision")
        pid, fc, start = daemon.process.pid, live.fc, time.monotonic()
        before, cpu = (fc.imu_sent, len(fc.heard[VISION]), len(fc.fused)), cpu_s(pid)
        while time.monotonic() - start < seconds:
            time.sleep(1.0)
            rss.append(rss_mb(pid))
            each_second(len(rss), daemon)
        spent, cpu = time.monotonic() - start, cpu_s(pid) - cpu
        after = (fc.imu_sent, len(fc.heard[VISION]), len(fc.fused))
        time.sleep(1.5)
        status = json.loads((folder / "status.json").read_text())
        daemon.stop()
        poses, everything = fc.heard[VISION][before[1] : after[1]], len(fc.heard[VISION])
        ages = [(live.start_ns + t) * 1e-6 - m.usec * 1e-3 for t, m in poses]
    imu, got, fused = (b - a for a, b in zip(before, after, strict=True))
    return Soak(spent, imu, after[0], everything, got, fused, ages, status, rss, cpu / spent)
