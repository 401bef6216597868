"""comparison.json keeps its contract, whatever the estimators did; the table marks the better."""

import dataclasses
import json
import subprocess
import sys

import numpy as np
import pytest
from evaluate_flights import MS, empty, estimate, make_truth, stamps
from rich.console import Console

from tagvo import geometry as geo
from vio.errors import EvaluationError
from vio.evaluate.align import Alignment, apply
from vio.evaluate.compare import COLUMNS, comparison, jsonable, table, write_json

FRAMES = {"total": 200, "with_pose": 198, "fused": 190, "rejected": 8}
TIMING = {"detect": {"p50": 3.0, "p99": 9.0}, "total": {"p50": 4.0, "p99": np.float64("nan")}}


def compare(trajectories, truth=None, **options):
    truth = truth or make_truth()
    return comparison(trajectories, truth, frames=FRAMES, timing_ms=TIMING, **options)


@pytest.fixture
def two():
    rng = np.random.default_rng(0)
    vo = estimate(stamps(200), rng, sigma=0.02, latency_ms=60.0)
    vio = estimate(stamps(2000, 5.0), rng, name="vio", sigma=0.01, latency_ms=1.0, full=True)
    return [vo, vio]


def shown(content, width=80):
    console = Console(width=width, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    console.print(table(content))
    return console.export_text()


def test_the_shape_is_the_contract(two):
    content = compare(two)
    assert set(content) == {"align", "estimators", "frames", "timing_ms"}
    assert content["align"] == "none"
    assert list(content["estimators"]) == ["vo", "vio"]
    assert content["frames"] == FRAMES
    assert content["timing_ms"]["total"] == {"p50": 4.0, "p99": None}
    for views in content["estimators"].values():
        assert set(views) == {"capture", "now"}
        assert len(views["capture"]) == len(views["now"]) == 14
    assert content["estimators"]["vo"]["capture"]["velocity_rmse_m_s"] is None
    assert content["estimators"]["vo"]["capture"]["nees_pose"] is None
    assert content["estimators"]["vio"]["capture"]["velocity_rmse_m_s"] > 0.0


def test_the_file_is_strict_json_without_nan(two, tmp_path):
    bad = dataclasses.replace(two[0], p_WI=two[0].p_WI * np.inf)
    write_json(tmp_path / "c.json", compare([bad, two[1], empty("vo_kf")]))

    def refuse(word):
        raise AssertionError(word)

    read = json.loads((tmp_path / "c.json").read_text(), parse_constant=refuse)
    for name in ("vo", "vo_kf"):
        assert read["estimators"][name]["capture"] is None
        assert read["estimators"][name]["now"]["position_rmse_m"] is None
        assert read["estimators"][name]["now"]["coverage"] == 0.0
        assert read["estimators"][name]["now"]["n"] == 0


def test_numpy_values_become_plain_ones():
    value = {"a": np.int64(3), "b": np.float32("inf"), "c": (np.array([1.5, np.nan]), True, "x")}
    assert jsonable(value) == {"a": 3, "b": None, "c": [[1.5, None], True, "x"]}


def test_some_rows_without_numbers_do_not_spoil_the_rest(two):
    p = two[0].p_WI.copy()
    p[::10] = np.nan
    holed = compare([dataclasses.replace(two[0], p_WI=p)])["estimators"]["vo"]
    assert holed["capture"]["n"] == 180
    assert holed["capture"]["position_rmse_m"] < 0.05


def test_skip_cuts_both_views_but_keeps_what_was_known_before(two):
    truth = make_truth()
    figures = compare(two[:1], truth, t_start_ns=int(truth.t_ns[100]))["estimators"]["vo"]
    assert figures["capture"]["n"] == figures["now"]["n"] == 100
    assert figures["now"]["coverage"] == 1.0
    ends = compare(two[:1], truth, t_end_ns=int(truth.t_ns[49]))["estimators"]["vo"]
    assert ends["capture"]["n"] == 50


def test_alignment_is_found_at_capture_and_used_in_both_views(two):
    turn = Alignment(geo.exp(np.array([0.1, -0.2, 0.5])), np.array([3.0, 4.0, 5.0]))
    moved = [apply(turn, x) for x in two]
    plain, free = compare(two), compare(moved, align="se3")
    for name in ("vo", "vio"):
        for view in ("capture", "now"):
            a, b = plain["estimators"][name][view], free["estimators"][name][view]
            assert b["position_rmse_m"] == pytest.approx(a["position_rmse_m"], rel=0.1)
            assert b["rotation_rmse_deg"] == pytest.approx(a["rotation_rmse_deg"], rel=0.1)
    vio = free["estimators"]["vio"]["capture"]
    assert vio["velocity_rmse_m_s"] == pytest.approx(
        plain["estimators"]["vio"]["capture"]["velocity_rmse_m_s"], rel=0.1
    )
    assert vio["nees_pose"] == pytest.approx(1.0, abs=0.15)


def test_alignment_never_looks_before_the_skip(two):
    truth = make_truth()
    p = two[0].p_WI.copy()
    p[:100] += 100.0
    shifted = dataclasses.replace(two[0], p_WI=p)
    options = {"align": "yaw", "t_start_ns": int(truth.t_ns[100])}
    a, b = (compare([x], truth, **options)["estimators"]["vo"] for x in (shifted, two[0]))
    assert a["capture"] == b["capture"]


def test_an_alignment_that_cannot_be_had_names_the_estimator(two):
    still = dataclasses.replace(two[0], p_WI=np.ones_like(two[0].p_WI))
    with pytest.raises(EvaluationError, match=r"^vo: align se3"):
        compare([still], align="se3")


def test_the_table_fits_a_terminal_and_marks_the_better(two):
    text = shown(compare(two))
    lines = [line for line in text.splitlines() if line.strip().startswith(("vo", "vio"))]
    assert [line.split()[:2] for line in lines] == [
        ["vo", "capture"], ["vo", "now"], ["vio", "capture"], ["vio", "now"],
    ]  # fmt: skip
    assert "…" not in text
    assert lines[2].split()[2].endswith("*")
    assert "*" not in lines[0]


def test_the_table_marks_nothing_where_there_is_nothing_to_choose(two):
    lines = shown(compare(two[:1])).splitlines()[1:]
    assert not any("*" in line for line in lines)
    twin = dataclasses.replace(two[0], name="vo_kf")
    lines = shown(compare([two[0], twin])).splitlines()[1:]
    assert not any("*" in line for line in lines)


def test_the_table_shows_a_dash_where_a_figure_cannot_be_had():
    line = next(x for x in shown(compare([empty("vio")])).splitlines() if "capture" in x)
    assert set(line.split()[2:]) == {"-"}


def test_every_column_is_a_figure_of_the_contract(two):
    figures = compare(two)["estimators"]["vio"]["now"]
    assert {c.key for c in COLUMNS} <= set(figures)


def test_late_output_makes_the_live_view_worse_only(two):
    later = dataclasses.replace(two[1], known_ns=two[1].known_ns + 300 * MS)
    a, b = (compare([x])["estimators"]["vio"] for x in (two[1], later))
    assert a["capture"] == b["capture"]
    assert b["now"]["position_rmse_m"] > 3.0 * a["now"]["position_rmse_m"]


def test_importing_the_judges_loads_nothing_heavy():
    code = (
        "import sys, vio.evaluate.compare, vio.evaluate.report\n"
        "heavy = {'plotly', 'rich', 'scipy', 'matplotlib', 'cv2'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("size", [1.0, 1e3, 5e6, 1e9])
def test_the_table_keeps_its_names_at_80_columns_however_wrong_an_estimate_is(two, size):
    far = dataclasses.replace(two[1], name="fc", p_WI=two[1].p_WI + size)
    text = shown(compare([two[0], far]))
    lines = text.splitlines()
    assert max(map(len, lines)) <= 80
    assert "\u2026" not in text
    assert sum("capture" in line for line in lines) == 2
    assert sum(line.strip().startswith("fc ") for line in lines) == 2
