"""`tagvio reproduce`: statistics, orderings both ways, a short flight, going on when stopped."""

import json
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from cli_calls import tagvio

import vio.commands.reproduce as command
from tagvo.errors import TagvoError
from vio.errors import SimulationError, VioError
from vio.records import Phase
from vio.reproduce import plan, study
from vio.reproduce.fly import fly, windows
from vio.reproduce.orderings import orderings
from vio.reproduce.printed import PaperTables
from vio.reproduce.records import Judge, Scores, Task, pooled, scored
from vio.reproduce.tables import document, future_table
from vio.sim.recording import simulated
from vio.sim.scenario import load_scenario

PLAIN = "scene.texture.kind=plain"  # nothing is drawn here: no floor needs to be made
SHORT = Task(
    "2 m/s", "fast", ("flight.speed_m_s=2", "flight.swings=2", "flight.takeoff=false",
                      "stream.rate_hz=10", PLAIN), 3, False,
    (Judge("speed", (), ("NEW", "joint", "VIO", "NEW+FIR")),),
)  # fmt: skip


def errors(rng, n, size=0.02):
    return np.abs(rng.normal(size, 0.01, n)), np.abs(rng.normal(1.0, 0.3, n))


def made(study_name, case, phase, arm, view="capture", p=0.02, o=1.0, n=100):
    """A score whose errors are all alike."""
    return scored((study_name, case, phase, arm, view), np.full(n, p), np.full(n, o), 1.0)


def test_the_farthest_flights_of_the_future_work_can_be_flown():
    """One that leaves its map would end the whole study, after all others were flown."""
    ends = ("map.every=16", "flight.speed_m_s=4", "scene.hidden_share=0.6")
    future = [t for t in plan.tasks(1, 1, True, True) if t.words[0] in ends]
    assert len(future) == 3
    for task in future:
        simulated(load_scenario(task.scenario, (f"seed={task.seed}", *task.words, PLAIN)))


def test_pooled_scores_are_those_of_all_errors_together():
    rng = np.random.default_rng(0)
    parts = [errors(rng, n, size) for n, size in ((50, 0.02), (300, 0.1), (7, 0.5))]
    names = ("static", "HR XL", "XL", "JBT", "capture")
    whole = pooled([scored(names, p, o, 1.0) for p, o in parts], "HR XL", "XL")
    p, o = (np.concatenate(x) for x in zip(*parts, strict=True))
    assert whole.n == len(p)
    found = (whole.p_mean, whole.p_std, whole.p_rms, whole.o_mean, whole.o_std, whole.o_rms)
    expected = [f(x) for x in (p, o) for f in (np.mean, np.std, lambda e: np.sqrt(np.mean(e**2)))]
    assert found == pytest.approx(expected, rel=1e-9)
    assert scored(names, np.zeros(0), np.zeros(0), 1.0) is None
    assert pooled([], "a", "b") is None


def test_the_papers_figures_stand_where_they_belong():
    paper = PaperTables()
    assert len(paper) == 5 * 8 + 2 * 2 * (4 + 7 + 1)
    a3 = paper.get("flights", "HR T2", "A3", "JBT")
    assert (a3.e_p_cm, a3.e_o_deg) == ((12.85, 4.96), (6.24, 1.70))
    xl = paper.get("static", "HR XL", "XL", "TBS-OR")
    assert (xl.e_p_cm, xl.e_o_deg) == ((3.34, 1.76), (3.24, 0.41))
    assert paper.get("static", "QR XL", "XL", "TBS-OR") is None


def papers_world():
    """Scores of HR in which every ordering of the paper holds."""
    out = []
    for place in plan.PLACES:
        sizes = {"JBT": 0.05, "ALL-notOR": 0.18, "ALL-OR": 0.08, "TBS-notOR": 0.04,
                 "TBS-OR": 0.03, "TBS-OR-W1-QL2": 0.031}  # fmt: skip
        out += [made("static", f"HR {place}", place, arm, p=p) for arm, p in sizes.items()]
    for k, phase in enumerate(("S0", "A1", "A2", "A3")):
        out += [
            made("flights", "HR T2", phase, arm, p=0.01 * (k + 1) * f)
            for arm, f in (("NEW", 1), ("JBT", 2))
        ]
    for flight in plan.FLIGHTS:
        case, whole = f"HR {flight}", plan.WHOLE
        out += [
            made("flights", case, whole, "NEW", p=0.03),
            made("flights", case, whole, "JBT", p=0.05),
        ]
        for name in ("flights", "nuisances"):
            out += [
                made(name, case, whole, "NEW", "now", p=0.1),
                made(name, case, whole, "VIO", "now", p=0.02),
            ]
        out.append(made("calibrated", case, whole, "VIO", "now", p=0.014, o=0.59))
    return out


def test_orderings_hold_in_the_papers_world_and_not_when_it_is_turned_round():
    world = papers_world()
    claims = [c for c in orderings(Scores(world)) if c.claim.startswith("HR")]
    assert len(claims) > 15
    assert {c.held for c in claims} == {True}
    assert all(c.reason == "" for c in claims)
    turned = [
        replace(s, p_sum=s.n / s.p_sum, p_squares=s.n**3 / s.p_sum**2, p50_m=1 / s.p50_m)
        for s in world
    ]
    claims = {c.claim: c for c in orderings(Scores(turned)) if c.claim.startswith("HR")}
    alike = {k for k, c in claims.items() if c.held}
    assert alike == set()
    assert all(c.reason for c in claims.values())
    qr = [c for c in orderings(Scores(world)) if c.claim.startswith("QR")]
    assert {c.held for c in qr} == {None}, "the quadrotor was not flown"


def test_the_reason_follows_the_distributions():
    world = papers_world()
    rows = [s for s in world if (s.case, s.arm) != ("HR XL", "TBS-OR")]
    tail = scored(("static", "HR XL", "XL", "TBS-OR", "capture"),
                  np.r_[np.full(90, 0.01), np.full(10, 0.9)], np.ones(100), 1.0)  # fmt: skip
    worse = made("static", "HR XL", "XL", "TBS-OR", p=0.09)
    for score, word in ((tail, "the worst ones are not"), (worse, "worse, too")):
        (claim,) = [
            c for c in orderings(Scores([*rows, score])) if c.claim == "HR static XL: TBS-OR < JBT"
        ]
        assert claim.held is False
        assert word in claim.reason


def test_the_document_has_ours_beside_the_papers():
    scores = Scores(papers_world())
    text = document(scores, orderings(scores), "Made here.")
    row = next(x for x in text.splitlines() if x.startswith("| A3 | "))
    assert row.split(" | ")[1:3] == ["8.00±0.00", "4.00±0.00"]
    assert row.rstrip(" |").split(" | ")[-2:] == ["12.85±4.96", "5.41±1.92"]
    assert "| XL, paper | 6.03±4.11 |" in text


def test_a_short_flight_is_judged_and_repeats_itself():
    one = fly(SHORT)
    again = fly(replace(SHORT, judges=(Judge("speed", (), ("VIO",)),)))
    assert again == [s for s in one if s.arm == "VIO"] != []
    scores = Scores(one)
    arms = {a: scores.get("speed", "2 m/s", plan.WHOLE, a) for a in ("NEW", "joint", "NEW+FIR")}
    assert 0.001 < arms["joint"].p_rms < arms["NEW"].p_rms < 0.2
    assert arms["NEW+FIR"].p_rms > 3 * arms["NEW"].p_rms, "at 10 Hz and 2 m/s the FIR lags by 0.2 s"
    live = {a: scores.get("speed", "2 m/s", plan.WHOLE, a, "now").p_rms for a in ("NEW", "VIO")}
    assert live["VIO"] < 0.5 * live["NEW"]


def test_what_cannot_be_flown_says_which():
    with pytest.raises(SimulationError, match=r"fast flight\.reach_m=\[0,9,0\]: "):
        study.flown(replace(SHORT, words=("flight.reach_m=[0,9,0]",)), None)


@pytest.fixture
def quick_flights(monkeypatch):
    """Flights that are counted, not flown."""
    seen = []

    def pretended(task):
        seen.append(task)
        return [made("speed", task.case, plan.WHOLE, "NEW", p=0.01 * task.seed)]

    monkeypatch.setattr(study, "fly", pretended)
    return seen


def test_what_is_done_is_not_done_again(quick_flights, tmp_path):
    todo = [replace(SHORT, seed=s) for s in range(1, 5)]
    first = list(study.fly_all(todo[:3], tmp_path, 1, None))
    assert len(quick_flights) == 3
    assert list(study.fly_all(todo, tmp_path, 1, None))[:3] == first
    assert [t.seed for t in quick_flights] == [1, 2, 3, 4]
    next(tmp_path.glob("*.json")).write_text("[{")
    list(study.fly_all(todo, tmp_path, 1, None))
    assert len(quick_flights) == 5, "what cannot be read is flown again"


def test_ctrl_c_leaves_what_there_is_and_the_same_call_goes_on(
    quick_flights, tmp_path, monkeypatch
):
    todo = [replace(SHORT, seed=s) for s in (1, 2, 3)]
    monkeypatch.setattr(plan, "tasks", lambda *a: todo)
    monkeypatch.setattr(command, "_warm", lambda: None)

    @contextmanager
    def at_once():
        yield lambda: True

    with monkeypatch.context() as m:
        m.setattr(command, "gently", at_once)
        done = tagvio("reproduce", "--out", tmp_path, "--jobs", "1")
    assert done.code == 130
    assert "stopped by Ctrl-C after 1 of 3 flights" in done.err
    assert "**Interrupted: 1 of 3 flights.**" in (tmp_path / "reproduce.md").read_text()
    done = tagvio("reproduce", "--out", tmp_path, "--jobs", "1")
    assert done.code == 0, done.err
    assert len(quick_flights) == 3
    content = json.loads((tmp_path / "reproduce.json").read_text())
    assert len(content["scores"]) == 3
    assert "Interrupted" not in content["made"]


def test_a_cluster_that_is_not_there_is_one_line(tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr(study, "_CLUSTER_S", 1.0)
    with pytest.raises(
        (VioError, TagvoError), match=r"--cluster tcp://127\.0\.0\.1:9: no scheduler"
    ):
        list(study.fly_all([SHORT], tmp_path, 1, "tcp://127.0.0.1:9"))


def test_every_flight_of_the_plan_is_a_scenario():
    """Names, places and keys are right: what is wrong would show only after many minutes."""
    from vio.sim.scenario import load_scenario

    todo = plan.tasks(1, 1, quick=False, images=True)
    assert len({(t.case, t.scenario, t.words) for t in todo}) == len(todo)
    for task in todo:
        for judge in task.judges:
            scenario = load_scenario(
                task.scenario, (f"seed={task.seed}", *task.words, *judge.words)
            )
            assert scenario.seed == 1
    flown = {(j.study, t.case) for t in todo for j in t.judges}
    assert {("static", f"{v} {p}") for v in plan.VEHICLES for p in plan.PLACES} <= flown
    for name in ("flights", "calibrated", "nuisances"):
        assert {(name, f"{v} {f}") for v in plan.VEHICLES for f in plan.FLIGHTS} <= flown


def test_curves_are_in_the_order_of_what_they_are_over():
    """Flights end in any order."""
    scores = Scores(
        made("latency", case, "flight", "joint") for case in ("200 ms", "0 ms", "100 ms")
    )
    rows = future_table(scores, "latency").splitlines()[2:]
    assert [row.split("|")[1].strip() for row in rows] == ["0 ms", "100 ms", "200 ms"]


def test_phases_of_one_name_are_judged_together():
    """A hover place is one phase a height; all of them are its figure."""
    spans = [("XL", 0, 10), ("still", 10, 20), ("XL", 20, 30), ("Ld", 30, 40)]
    found = windows([Phase(*span) for span in spans])
    assert {name: [(w.t_start_ns, w.t_end_ns) for w in parts] for name, parts in found.items()} == {
        "XL": [(0, 10), (20, 30)], "Ld": [(30, 40)], "flight": [(0, 40)]}  # fmt: skip
