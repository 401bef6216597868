"""Says once a second how the flight is: log line, status file, systemd and its watchdog."""

import json
import logging
import os
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tagvo.textfile import write_atomic
from vio.daemon.systemd import Systemd

LOG = logging.getLogger("vio.daemon")
_EVERY_S = 1.0
_FLOWS_S = 2.0  # without a new frame or sample for so long, nothing flows


@dataclass(slots=True)
class Rates:
    """Turns counts into rates, second by second; `flows`: when each last grew."""

    _before: dict[str, tuple[float, int]] = field(default_factory=dict)
    _grew: dict[str, float] = field(default_factory=dict)

    def per_second(self, name: str, count: int, now_s: float) -> float:
        """The rate of a count since it was last asked for [1/s]."""
        then_s, before = self._before.get(name, (now_s, count))
        self._before[name] = (now_s, count)
        if count > before or (count and name not in self._grew):
            self._grew[name] = now_s
        return (count - before) / (now_s - then_s) if now_s > then_s else 0.0

    def silent_s(self, name: str, now_s: float) -> float | None:
        """How long a count has not grown; None: it never did."""
        grew = self._grew.get(name)
        return None if grew is None else now_s - grew


def cpu_by_thread() -> dict[str, float]:
    """CPU time that each thread of Python's has used so far [s], by its name."""
    spent: dict[str, float] = {}
    for thread in threading.enumerate():
        try:
            text = Path(f"/proc/self/task/{thread.native_id}/stat").read_text()
        except OSError:  # it has ended, or this is no Linux
            continue
        fields = text.rpartition(")")[2].split()
        ticks = int(fields[11]) + int(fields[12])
        spent[thread.name] = spent.get(thread.name, 0.0) + ticks / os.sysconf("SC_CLK_TCK")
    return spent


class Status:
    """Asks `collect` for the figures once a second, in a thread of its own.

    collect(rates, now_s): a tree of plain values with `counts` of frames and imu, and `line`, what
    the log says.
    """

    def __init__(
        self,
        collect: Callable[[Rates, float], dict[str, Any]],
        file: Path | None,
        systemd: Systemd,
    ) -> None:
        self._collect, self._file, self._systemd = collect, file, systemd
        self._rates = Rates()
        self._stop = threading.Event()
        self._file_failed = False
        self.latest: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._live, name="status", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """Say it a last time and end."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(0.5)

    def _live(self) -> None:
        every = min(_EVERY_S, (self._systemd.watchdog_s or 10.0) / 2.0)
        said = -_EVERY_S
        while not self._stop.wait(every):
            now = time.monotonic()
            self._look(now, now - said >= 0.9 * _EVERY_S)
            said = now if now - said >= 0.9 * _EVERY_S else said
        self._look(time.monotonic(), False)

    def _look(self, now_s: float, aloud: bool) -> None:
        try:
            self.latest = status = self._collect(self._rates, now_s)
        except Exception:
            LOG.exception("status goes on after a fault")
            return
        line = str(status["line"])
        if aloud:
            LOG.info("%s", line)
        words = [f"STATUS={line}"]
        if self._flows(now_s):
            words.append("WATCHDOG=1")
        self._systemd.tell(*words)
        self._write(status)

    def _flows(self, now_s: float) -> bool:
        """Frames and samples flow, or the first of them is still waited for (no FC, say)."""
        silent = [self._rates.silent_s(name, now_s) for name in ("frames", "imu")]
        return all(s is None or s < _FLOWS_S for s in silent)

    def _write(self, status: dict[str, Any]) -> None:
        self._file_failed = not write_status(self._file, status, quiet=self._file_failed)


def write_status(file: Path | None, status: dict[str, Any], *, quiet: bool = False) -> bool:
    """Write the status file, if there is one; false, and a log line unless quiet: it failed."""
    if file is None:
        return True
    try:
        write_atomic(file, json.dumps(status, indent=1) + "\n")
    except OSError as err:
        if not quiet:
            LOG.warning("status file %s: %s", file, err.strerror or err)
        return False
    return True


def waiting_status(url: str, seconds: float) -> dict[str, Any]:
    """The status while no autopilot has been heard, for so long on that link."""
    return {
        "state": "WAITING",
        "reasons": ["no_autopilot"],
        "vehicle": None,
        "counts": {"frames": 0, "with_pose": 0, "imu": 0, "messages": 0},
        "rates_hz": {},
        "counters": {},
        "alarms": [],
        "sigma": None,
        "line": f"WAITING for an autopilot at {url}, {seconds:.0f} s",
    }
