"""The report is one page that needs no network, says the outcome first and stays small."""

import dataclasses
import re

import numpy as np
import pytest
from evaluate_flights import empty, estimate, make_truth, stamps
from jinja2 import UndefinedError
from numpy.testing import assert_allclose

from tagvo.tags.tag_map import map_from_dict
from vio.evaluate.compare import comparison
from vio.evaluate.report import polylines
from vio.evaluate.report.html import render
from vio.evaluate.report.report import Extra, share_outside, write_report
from vio.evaluate.report.sections import Picture
from vio.evaluate.report.verdict import verdict

TAGS = [{"id": i, "size": 0.2, "p": [0.5 * i, 0.0, 0.0], "q": [1, 0, 0, 0]} for i in range(3)]
GRAVITY = {"dir": [0, 0, -1], "sigma_deg": 1}


@pytest.fixture
def tag_map():
    return map_from_dict({"family": "tag36h11", "tags": TAGS, "gravity": GRAVITY}, "map")


def trajectories(seed=0):
    rng = np.random.default_rng(seed)
    vo = estimate(stamps(200), rng, sigma=0.02, latency_ms=60.0)
    vio = estimate(stamps(2000, 5.0), rng, name="vio", latency_ms=1.0, full=True)
    return [vo, vio]


def compare(estimates, truth, timing=None):
    frames = {"total": 200, "with_pose": 198, "fused": 190, "rejected": 8}
    return comparison(estimates, truth, frames=frames, timing_ms=timing or {})


def write(path, estimates, tag_map=None, extra=None, timing=None):
    truth = make_truth()
    content = compare(estimates, truth, timing)
    write_report(path, content, estimates, truth, tag_map, extra)
    text = path.read_text(encoding="utf-8")
    return text, text[text.index("<body>") :]


def test_the_page_is_whole_offline_and_below_8_mb(tmp_path, tag_map):
    n = 200
    counts = np.arange(n) % 7
    extra = Extra(title="a <b>flight</b>", tags_t_ns=stamps(n), tags_count=counts, notes=("x < y",))
    timing = {"detect": {"p50": 3.0, "p99": 9.0}}
    text, body = write(tmp_path / "report.html", trajectories(), tag_map, extra, timing)
    assert len(text.encode()) < 8e6
    assert not re.search(r"<(script|link|img|iframe)[^>]+(src|href)=", text)
    assert text.count("* plotly.js v") == 1
    assert "a &lt;b&gt;flight&lt;/b&gt;" in body
    assert "x &lt; y" in body
    for part in ("trajectory", "errors", "axes-vio-0", "axes-vio-1", "tags", "timing"):
        assert f'id="{part}"' in body
    assert "axes-vo-0" not in body  # VO states no covariance here
    assert "prefers-color-scheme: dark" in text
    assert 'name="viewport"' in text


def test_a_moment_is_shown_with_what_it_says_and_its_image(tmp_path):
    extra = Extra(moments=(Picture('a < b & "c"', b"\xff\xd8", (560, 420)),))
    _, body = write(tmp_path / "r.html", trajectories()[:1], extra=extra)
    assert "<figcaption>a &lt; b &amp; &#34;c&#34;</figcaption>" in body
    assert 'viewBox="0 0 560 420"' in body
    assert 'href="data:image/jpeg;base64,/9g="' in body


def test_what_a_page_is_not_given_is_an_error():
    with pytest.raises(UndefinedError, match="'body' is undefined"):
        render("page.html", title="t", library="")


def test_the_verdict_stands_before_every_figure(tmp_path):
    _, body = write(tmp_path / "r.html", trajectories())
    assert body.index('class="verdict"') < body.index("<table>") < body.index('id="trajectory"')


@pytest.mark.parametrize("estimates", [[], [empty("vio")], [empty("vo"), trajectories()[1]]])
def test_a_run_that_gave_nothing_still_has_a_report(tmp_path, estimates):
    _, body = write(tmp_path / "r.html", estimates)
    assert 'class="verdict"' in body
    assert "Timing" not in body
    assert ">nan<" not in body


def test_a_very_long_flight_stays_small(tmp_path):
    n = 40_000
    truth = make_truth(n, 5.0)
    rng = np.random.default_rng(0)
    names = ("vo", "vo_fir", "vo_kf", "vio")
    estimates = [estimate(truth.t_ns, rng, name=name, full=True) for name in names]
    path = tmp_path / "r.html"
    write_report(path, compare(estimates, truth), estimates, truth, None)
    assert path.stat().st_size < 8e6, path.stat().st_size


def test_verdict_names_the_best_and_compares_it_with_vo():
    truth = make_truth()
    text = verdict(compare(trajectories(), truth))
    assert re.match(r"Live, VIO was the best: off by \d.* for VO; at the moment", text)
    assert text.count(".") - len(re.findall(r"\d\.\d", text)) == 1  # one sentence
    assert "VO was off by" in verdict(compare(trajectories()[:1], truth))
    assert verdict(compare([empty()], truth)).startswith("No estimator")


def test_verdict_says_so_where_vo_is_the_better():
    vo, vio = trajectories()
    swapped = [dataclasses.replace(vo, name="vio"), dataclasses.replace(vio, name="vo")]
    assert "VO was the best" in verdict(compare(swapped, make_truth()))


def test_thinning_keeps_peaks_ends_and_gaps():
    rng = np.random.default_rng(1)
    y = rng.normal(size=50_000)
    y[12_345], y[23_456], y[34_567] = 100.0, -100.0, np.nan
    t, kept = polylines.thin(np.arange(50_000.0), y, 1000)
    assert len(kept) <= 1010 + 1000 // 100
    assert (np.nanmax(kept), np.nanmin(kept)) == (100.0, -100.0)
    assert np.isnan(kept).sum() == 1
    assert (np.diff(t) > 0).all()
    assert_allclose(kept[~np.isnan(kept)], y[t[~np.isnan(kept)].astype(int)])


def test_lines_run_in_time_and_break_at_long_pauses():
    t_ns = stamps(6)[[0, 2, 1, 3, 4, 5]]
    t_ns[4:] += 5_000_000_000
    t_s, y = polylines.in_time(t_ns, np.array([0.0, 2.0, 1.0, 3.0, 4.0, 5.0]), int(t_ns[0]))
    assert (np.diff(t_s) >= 0).all()
    assert_allclose(y, [0, 1, 2, 3, np.nan, 4, 5])


def test_a_band_is_a_closed_outline_for_each_stretch():
    half = np.array([1.0, 2.0, np.nan, 3.0])
    t_s, y = polylines.band(np.arange(4.0), half)
    assert_allclose(y, [1, 2, -2, -1, np.nan, 3, -3, np.nan])
    assert_allclose(t_s, [0, 1, 1, 0, np.nan, 3, 3, np.nan])


def test_tags_are_drawn_where_they_lie(tag_map):
    points, names = polylines.tag_outlines(tag_map)
    assert points.shape == (18, 3)
    assert names[6] == "tag 1, 20 cm"
    assert_allclose(np.nanmean(points[6:10], axis=0), [0.5, 0.0, 0.0])
    assert_allclose(points[6], points[10])
    assert np.isnan(points[11]).all()


def test_three_sigma_holds_nearly_all_errors_of_an_honest_estimator():
    from vio.evaluate.compare import judge
    from vio.evaluate.truth import clean_truth

    truth = make_truth(2000)
    x = estimate(truth.t_ns, np.random.default_rng(2), full=True)
    assert 0.0005 < share_outside(judge(x, clean_truth(truth))) < 0.006
    proud = dataclasses.replace(x, cov=x.cov / 9.0)
    assert share_outside(judge(proud, clean_truth(truth))) == pytest.approx(0.317, abs=0.02)
