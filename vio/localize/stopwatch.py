"""Times the stages of the work from outside: core code reads no clock, it only says `lap`."""

import os
import time
from collections import deque
from pathlib import Path

import numpy as np

STAGES = ("detect", "tagpose", "select", "fuse", "joint", "filter")


class Stopwatch:
    """Collects the durations of named stages, frame by frame."""

    def __init__(self, keep: int | None = None) -> None:
        """keep: how many durations of each stage count, the last ones; None: all."""
        self._ns: dict[str, deque[int]] = {}
        self._keep = keep
        self._start = self._last = time.perf_counter_ns()

    def start(self) -> None:
        """A frame begins."""
        self._start = self._last = time.perf_counter_ns()

    def lap(self, stage: str) -> None:
        """A stage has ended."""
        now = time.perf_counter_ns()
        self._of(stage).append(now - self._last)
        self._last = now

    def add(self, stage: str, ns: int) -> None:
        """A stage that ran elsewhere took so long [ns]."""
        self._of(stage).append(ns)

    def stop(self) -> None:
        """The frame has ended; its whole duration is `total`."""
        self._of("total").append(time.perf_counter_ns() - self._start)

    def _of(self, stage: str) -> "deque[int]":
        return self._ns.setdefault(stage, deque(maxlen=self._keep))

    def summary(self) -> dict[str, dict[str, float]]:
        """p50 and p99 of each stage that ran [ms], in the order of the pipeline."""
        took = {s: np.array(list(self._ns[s])) for s in (*STAGES, "total") if s in self._ns}
        return {s: _quantiles(ns * 1e-6) for s, ns in took.items()}


def clocks_ns() -> tuple[int, int]:
    """Wall time and CPU time of this thread [ns]; differences alone mean something."""
    return time.perf_counter_ns(), time.thread_time_ns()


def resident_mb() -> float:
    """Memory of this process that is in RAM [MB], 0 where the system does not say (no /proc)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return 0.0
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def _quantiles(ms: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> dict[str, float]:
    p50, p99 = np.percentile(ms, [50, 99])
    return {"p50": round(float(p50), 4), "p99": round(float(p99), 4)}
