"""The report in a real browser: it draws without an error, on a phone and in the dark."""

import cv2
import numpy as np
import pytest
from browser import BROWSER, Browser
from cli_calls import tagvio
from flying_log import write_flying_log
from once import once

needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium: apt install chromium")
# What plotly puts off by 0.1 s is done when this is.
PROBE = """new Promise(done => setTimeout(() => {
  const plots = [...document.querySelectorAll(".js-plotly-plot")];
  done({
    inner: innerWidth, scroll: document.documentElement.scrollWidth, plots: plots.length,
    wide: plots.filter(p => p._fullLayout.width > document.body.clientWidth).length,
    drawn: plots.filter(p => p.querySelector("svg, canvas")).length,
  });
}, 500))"""


@pytest.fixture(scope="session")
def compared(tmp_path_factory):
    """The folder that `tagvio compare` has filled, once for all workers."""

    def make(root):
        log = write_flying_log(root, seconds=6.0)
        done = tagvio("compare", log, "--out", root / "out", "--blackout", "4,1", "--png")
        assert done.code == 0, done.err

    return once(tmp_path_factory, "report", make) / "out"


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    opened = Browser(tmp_path_factory.mktemp("profile"))
    yield opened
    opened.close()


def brightness(browser):
    """Grey values of the window."""
    return cv2.imdecode(np.frombuffer(browser.screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE)


@needs_browser
@pytest.mark.parametrize(("width", "scheme"), [(1200, "light"), (500, "dark")])
def test_it_draws_all_plots_within_the_page_by_day_and_in_the_dark(
    compared, browser, width, scheme
):
    browser.show(compared / "report.html", width, scheme)
    seen = browser.evaluate(PROBE)
    assert browser.errors == []
    assert seen["inner"] == width
    assert seen["scroll"] <= seen["inner"]
    assert seen["plots"] == seen["drawn"] >= 8
    assert seen["wide"] == 0
    shown = brightness(browser)
    assert np.median(shown) > 200 if scheme == "light" else np.median(shown) < 60
    assert shown.std() > 10


@needs_browser
def test_what_a_page_complains_of_is_heard(browser, tmp_path):
    page = tmp_path / "broken.html"
    page.write_text('<img src="nowhere.png"><script>console.error("a"); nonsense()</script>')
    browser.show(page, 500, "light")
    assert len(browser.errors) == 3


def test_the_plots_are_written_as_files_on_request(compared):
    for name in ("errors.png", "trajectory.png"):
        image = cv2.imread(str(compared / name))
        assert image.shape[1] > 1000
        assert image.std() > 5.0
