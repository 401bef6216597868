"""Which of the paper's orderings come out, with the figures, and why where one does not."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

from vio.reproduce.plan import FLIGHTS, PLACES, VEHICLES, WHOLE
from vio.reproduce.records import Score, Scores

_MUCH = 1.5  # by which `>>` is more than `>`
_RATIO = (0.4, 0.55)
_ALIKE_M = 0.01
_TYPICAL = 0.9  # a median at least so near to the other one is the same


@dataclass(frozen=True, slots=True)
class Ordering:
    """One claim: held, not held, or None where it was not flown; in figures; and why not."""

    claim: str
    held: bool | None
    figures: str
    reason: str = ""


def orderings(scores: Scores) -> list[Ordering]:
    """All of them, in the order of the paper's section of results."""
    out: list[Ordering] = []
    for v in VEHICLES:
        out += [*_static(scores, v), *_steps(scores, v), *_against_one_tag(scores, v)]
        out += [*_live(scores, v)]
    return out


def _static(scores: Scores, v: str) -> Iterator[Ordering]:
    def over(arm: str) -> Score | None:
        found = [scores.get("static", f"{v} {p}", p, arm) for p in PLACES]
        known = [s for s in found if s is not None]
        return Scores(_renamed(known)).get("static", "all", "all", arm) if known else None

    chain = ("ALL-notOR", "ALL-OR", "TBS-notOR", "TBS-OR")
    four = {name: over(name) for name in chain}
    for a, b in pairwise(chain):
        much = a == "ALL-notOR"
        yield _less(f"{v} static: {b} {'<<' if much else '<'} {a}", four[b], four[a],
                    _MUCH if much else 1.0)  # fmt: skip
    yield _ratio(f"{v} static: ALL-OR/ALL-notOR 0.40 to 0.55", four["ALL-OR"], four["ALL-notOR"])
    for p in PLACES:
        new, jbt = (scores.get("static", f"{v} {p}", p, arm) for arm in ("TBS-OR", "JBT"))
        yield _less(f"{v} static {p}: TBS-OR < JBT", new, jbt)
    yield _alike(f"{v} static: W1 and W2 within 1 cm", over("TBS-OR-W1-QL2"), four["TBS-OR"])


def _renamed(scores: Iterable[Score]) -> Iterator[Score]:
    return (replace(s, case="all", phase="all") for s in scores)


def _steps(scores: Scores, v: str) -> Iterator[Ordering]:
    names = ("S0", "A1", "A2", "A3")
    for arm in ("NEW", "JBT"):
        found = [scores.get("flights", f"{v} T2", phase, arm) for phase in names]
        claim = f"{v} T2: e_p of {arm} grows with height (S0 < A1 < A2 < A3)"
        known = [s for s in found if s is not None]
        if len(known) < len(found):
            yield Ordering(claim, None, "not flown")
            continue
        figures = ", ".join(f"{n} {_cm(s)}" for n, s in zip(names, known, strict=True))
        grows = [a.p_mean < b.p_mean for a, b in pairwise(known)]
        at = [f"{names[i]} to {names[i + 1]}" for i, up in enumerate(grows) if not up]
        yield Ordering(claim, all(grows), figures, f"falls from {' and '.join(at)}" if at else "")


def _against_one_tag(scores: Scores, v: str) -> Iterator[Ordering]:
    for flight in FLIGHTS:
        new, jbt = (scores.get("flights", f"{v} {flight}", WHOLE, a) for a in ("NEW", "JBT"))
        yield _less(f"{v} {flight}: NEW < JBT in position", new, jbt)


def _live(scores: Scores, v: str) -> Iterator[Ordering]:
    """Ours: the filter at the moment of use against the paper's pose held."""
    for flight in FLIGHTS:
        case = f"{v} {flight}"
        vio, new = (scores.get("flights", case, WHOLE, a, "now") for a in ("VIO", "NEW"))
        yield _less(f"{v} {flight}: VIO < NEW at the moment of use (now)", vio, new)
        yield _bound(case, scores.get("calibrated", case, WHOLE, "VIO", "now"))
        factor = 1.7 if flight == "T2" else 3.0
        vio, new = (scores.get("nuisances", case, WHOLE, a, "now") for a in ("VIO", "NEW"))
        yield _less(f"{v} {flight}, every nuisance: VIO {factor:g} times < NEW (now)", vio, new,
                    factor, rms=True)  # fmt: skip


def _bound(case: str, vio: Score | None) -> Ordering:
    claim = f"{case}, rig calibrated: VIO within 1.5 cm and 0.6 deg rms (now)"
    if vio is None:
        return Ordering(claim, None, "not flown")
    figures = f"{100 * vio.p_rms:.2f} cm, {vio.o_rms:.2f} deg"
    over = [w for w, bad in (("position", vio.p_rms > 0.015), ("rotation", vio.o_rms > 0.6)) if bad]
    return Ordering(claim, not over, figures, f"{' and '.join(over)} beyond it" if over else "")


def _less(
    claim: str, a: Score | None, b: Score | None, factor: float = 1.0, rms: bool = False
) -> Ordering:
    """Is the error of a less than that of b (at least `factor` times)?"""
    if a is None or b is None:
        return Ordering(claim, None, "not flown")
    x, y = (a.p_rms, b.p_rms) if rms else (a.p_mean, b.p_mean)
    figures = f"{100 * x:.2f} against {100 * y:.2f} cm, {y / max(x, 1e-9):.2f} times"
    held = x * factor < y
    return Ordering(claim, held, figures, "" if held else _why(a, b))


def _why(a: Score, b: Score) -> str:
    """What the distributions say of a mean that is not smaller."""
    medians = f"medians {100 * a.p50_m:.2f} and {100 * b.p50_m:.2f} cm"
    if a.p50_m < _TYPICAL * b.p50_m:
        return f"typical poses are better, the worst ones are not: {medians}"
    if b.p50_m < _TYPICAL * a.p50_m:
        return f"typical poses are worse, too: {medians}"
    return f"typical poses are alike: {medians}"


def _ratio(claim: str, a: Score | None, b: Score | None) -> Ordering:
    if a is None or b is None:
        return Ordering(claim, None, "not flown")
    ratio = a.p_mean / b.p_mean
    held = _RATIO[0] <= ratio <= _RATIO[1]
    side = "removal of outliers gains more" if ratio < _RATIO[0] else "it gains less"
    return Ordering(claim, held, f"{ratio:.2f}", "" if held else f"{side} here; {_medians(a, b)}")


def _alike(claim: str, a: Score | None, b: Score | None) -> Ordering:
    if a is None or b is None:
        return Ordering(claim, None, "not flown")
    apart = abs(a.p_mean - b.p_mean)
    held = apart < _ALIKE_M
    return Ordering(claim, held, f"{100 * apart:.2f} cm apart", "" if held else _medians(a, b))


def _medians(a: Score, b: Score) -> str:
    return f"medians {100 * a.p50_m:.2f} and {100 * b.p50_m:.2f} cm"


def _cm(s: Score) -> str:
    return f"{100 * s.p_mean:.2f} cm"
