"""The document: every table, ours beside the paper's, and the orderings."""

from collections.abc import Iterable, Iterator, Sequence

from vio.reproduce.orderings import Ordering
from vio.reproduce.plan import COLUMNS, FLIGHTS, PLACES, VEHICLES, WHOLE
from vio.reproduce.printed import PaperTables, Printed
from vio.reproduce.records import Score, Scores

_FLOWN = ("JBT", "NEW", "NEW+FIR", "JBT in the filter", "joint", "VIO", "VIO corners")
_PHASES = {"T1": ("F", "R", "B", "L"), "T2": ("S0", "A1", "A2", "A3", "D1", "D2", "D3"),
           "T3": ("T3",)}  # fmt: skip
_FUTURE = {
    "occlusion": "share of tags hidden (T3, QR)",
    "sparse": "every n-th tag lies there (T3, QR)",
    "latency": "images known so late (T3, QR)",
    "speed": "peak speed, to and fro (QR)",
}
_NONE = "-"


def document(scores: Scores, claims: Sequence[Ordering], head: str) -> str:
    """All of it as Markdown; head: how it was made."""
    parts = [
        "# The paper's tables, simulated",
        head,
        "Errors are mean ± standard deviation over time of e_p = |p - p_true| [cm] and of e_o, the"
        " angle between the two attitudes [deg]; `capture` at the moment of each image, `now` the"
        " last pose known, held, at every moment of truth (`now` as rms). `paper` is what was"
        " printed. NEW is TBS-OR-(W2+QL2) of each frame, NEW+FIR the same through the paper's FIR,"
        " JBT in the filter the single-tag pose with an IMU, joint all corners at once, VIO the"
        " filter on it, VIO corners the filter on the corners themselves.",
        "## Orderings",
        orderings_table(claims),
        "## Hover over five places",
        *static_tables(scores),
    ]
    for flight in FLIGHTS:
        parts += [f"## {flight}", *flight_tables(scores, flight)]
    parts += ["## Calibrated rig, and every nuisance at once (`now`, rms)", *live_tables(scores)]
    for study, what in _FUTURE.items():
        parts += [f"## {study.capitalize()}: {what}", future_table(scores, study)]
    return "\n\n".join(parts) + "\n"


def orderings_table(claims: Iterable[Ordering]) -> str:
    """Each claim with its figures."""
    word = {True: "held", False: "**not held**", None: "not flown"}
    rows = [(c.claim, word[c.held], c.figures, c.reason) for c in claims]
    return table(("claim", "", "figures", "why not"), rows)


def static_tables(scores: Scores) -> Iterator[str]:
    """By vehicle and place, all heights together, and ours by height."""
    paper = PaperTables()
    arms = (*COLUMNS, "NEW+FIR", "joint", "VIO")
    for v in VEHICLES:
        for unit in ("cm", "deg"):
            rows = []
            for p in PLACES:
                found = [scores.get("static", f"{v} {p}", p, a) for a in arms]
                if any(found):
                    rows.append((f"{p}", *(_cell(s, unit) for s in found)))
                printed = [paper.get("static", f"{v} {p}", p, a) for a in arms]
                if any(printed):
                    rows.append((f"{p}, paper", *(_printed(x, unit) for x in printed)))
            yield f"{v}, {'e_p [cm]' if unit == 'cm' else 'e_o [deg]'}"
            yield table(("place", *arms), rows)
    rows = [
        (f"{v} {p} {h:g} m", *(_cell(scores.get("static", f"{v} {p}", f"{p}/{h:g}", a), "cm")
                               for a in arms))
        for v in VEHICLES for p in PLACES for h in (0.8, 1.4, 2.0)
    ]  # fmt: skip
    yield "By height, e_p [cm]"
    yield table(("place", *arms), rows)


def flight_tables(scores: Scores, flight: str) -> Iterator[str]:
    """By phase: each estimator at the moment of its images, beside the paper; then live."""
    paper = PaperTables()
    for v in VEHICLES:
        case = f"{v} {flight}"
        for unit in ("cm", "deg"):
            rows = []
            for phase in (*_PHASES[flight], WHOLE):
                cells = [_cell(scores.get("flights", case, phase, a), unit) for a in _FLOWN]
                printed = [paper.get("flights", case, phase, a) for a in ("JBT", "NEW")]
                rows.append((phase, *cells, *(_printed(x, unit) for x in printed)))
            yield f"{case}, {'e_p [cm]' if unit == 'cm' else 'e_o [deg]'}, capture"
            yield table(("phase", *_FLOWN, "paper JBT", "paper NEW"), rows)
        live = [_rms(scores.get("flights", case, WHOLE, a, "now")) for a in _FLOWN]
        yield f"{case}, now, rms"
        yield table(("", *_FLOWN), [(WHOLE, *live)])


def live_tables(scores: Scores) -> Iterator[str]:
    """The filter and the held poses with the rig known and with everything wrong."""
    arms = ("NEW", "joint", "VIO", "VIO corners")
    for study in ("calibrated", "nuisances"):
        rows = [
            (f"{v} {f}", *(_rms(scores.get(study, f"{v} {f}", WHOLE, a, "now")) for a in arms))
            for v in VEHICLES for f in FLIGHTS
        ]  # fmt: skip
        yield f"{study}"
        yield table(("flight", *arms), rows)


def future_table(scores: Scores, study: str) -> str:
    """One curve of the paper's future work."""
    there = {s.case for s in scores.all if s.study == study}
    cases = sorted(there, key=lambda case: float(case.split()[0]))  # flown in no order
    arms = [
        ("NEW", "capture"),
        ("joint", "capture"),
        ("NEW", "now"),
        ("joint", "now"),
        ("VIO", "now"),
    ]
    rows = []
    for case in cases:
        found = [scores.get(study, case, WHOLE, arm, view) for arm, view in arms]
        covered = _NONE if found[1] is None else f"{100 * found[1].coverage:.0f} %"
        rows.append((case, covered, *(_rms(s) for s in found)))
    return table(("", "frames give a pose", *(f"{a} {v}" for a, v in arms)), rows)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _cell(s: Score | None, unit: str) -> str:
    if s is None:
        return _NONE
    if unit == "cm":
        return f"{100 * s.p_mean:.2f}±{100 * s.p_std:.2f}"
    return f"{s.o_mean:.2f}±{s.o_std:.2f}"


def _rms(s: Score | None) -> str:
    return _NONE if s is None else f"{100 * s.p_rms:.2f} cm {s.o_rms:.2f}°"


def _printed(x: Printed | None, unit: str) -> str:
    if x is None:
        return _NONE
    mean, std = x.e_p_cm if unit == "cm" else x.e_o_deg
    return f"{mean:.2f}±{std:.2f}"
