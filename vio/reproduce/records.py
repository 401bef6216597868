"""What is to be flown, and what came of it."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tagvo.geometry import Array


@dataclass(frozen=True, slots=True)
class Judge:
    """One comparison on the images of a task: what differs in the scenario, who takes part."""

    study: str
    words: tuple[str, ...]
    arms: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Task:
    """One flight: a scenario with `a.b=c` changes, and the comparisons made on what it shows.

    case: its name in tables (HR XL, QR T1, 0.3); images: rendered and searched for tags, else
    exact corners with noise.
    """

    case: str
    scenario: str
    words: tuple[str, ...]
    seed: int
    images: bool
    judges: tuple[Judge, ...]


@dataclass(frozen=True, slots=True)
class Score:
    """Errors of one estimator in one phase: sums of e_p [m] and e_o [deg] and of their squares.

    view: capture (each pose at its own moment) or now (the last one known, held); n: moments;
    p50_m: median of e_p; coverage: share of moments of truth with a pose.
    """

    study: str
    case: str
    phase: str
    arm: str
    view: str
    n: int
    p_sum: float
    p_squares: float
    o_sum: float
    o_squares: float
    p50_m: float
    coverage: float

    @property
    def p_mean(self) -> float:
        """Mean of e_p [m]."""
        return self.p_sum / self.n

    @property
    def p_std(self) -> float:
        """Standard deviation of e_p [m]."""
        return _std(self.p_sum, self.p_squares, self.n)

    @property
    def p_rms(self) -> float:
        """[m]"""
        return float(np.sqrt(self.p_squares / self.n))

    @property
    def o_mean(self) -> float:
        """Mean of e_o [deg]."""
        return self.o_sum / self.n

    @property
    def o_std(self) -> float:
        """Standard deviation of e_o [deg]."""
        return _std(self.o_sum, self.o_squares, self.n)

    @property
    def o_rms(self) -> float:
        """[deg]"""
        return float(np.sqrt(self.o_squares / self.n))


def scored(
    names: tuple[str, str, str, str, str], e_p: Array, e_o: Array, coverage: float
) -> Score | None:
    """The score of errors e_p (n,) [m] and e_o (n,) [deg]; None where there are none."""
    if not len(e_p):
        return None
    return Score(
        *names, len(e_p), float(e_p.sum()), float(e_p @ e_p), float(e_o.sum()), float(e_o @ e_o),
        float(np.median(e_p)), coverage,
    )  # fmt: skip


def pooled(scores: Iterable[Score], case: str, phase: str) -> Score | None:
    """Several scores of one estimator as one; the median is the mean of medians."""
    several = list(scores)
    if not several:
        return None
    n = np.array([s.n for s in several], dtype=float)
    first, share = several[0], n / n.sum()
    return Score(
        first.study, case, phase, first.arm, first.view, int(n.sum()),
        sum(s.p_sum for s in several), sum(s.p_squares for s in several),
        sum(s.o_sum for s in several), sum(s.o_squares for s in several),
        float(share @ [s.p50_m for s in several]), float(share @ [s.coverage for s in several]),
    )  # fmt: skip


def _std(total: float, squares: float, n: int) -> float:
    return float(np.sqrt(max(squares / n - (total / n) ** 2, 0.0)))


class Scores:
    """All scores, looked up by what they are of; seeds of one case are pooled."""

    def __init__(self, scores: Iterable[Score]) -> None:
        self.all = list(scores)
        found: dict[tuple[str, str, str, str, str], list[Score]] = {}
        for s in self.all:
            found.setdefault((s.study, s.case, s.phase, s.arm, s.view), []).append(s)
        self._found = found

    def get(
        self, study: str, case: str, phase: str, arm: str, view: str = "capture"
    ) -> Score | None:
        """Pooled over seeds; None where it was not flown or gave no pose."""
        return pooled(self._found.get((study, case, phase, arm, view), ()), case, phase)

    def over(
        self, study: str, cases: Iterable[str], phase: str, arm: str, view: str = "capture"
    ) -> Score | None:
        """Pooled over cases too; None where any is missing."""
        each = [self.get(study, case, phase, arm, view) for case in cases]
        known = [s for s in each if s is not None]
        return pooled(known, "all", phase) if len(known) == len(each) else None
