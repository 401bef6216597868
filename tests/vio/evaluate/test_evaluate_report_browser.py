"""The report in a real browser: it draws without an error, on a phone and in the dark."""

import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest
from cli_calls import tagvio
from flying_log import write_flying_log

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser")
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no Chromium: apt install chromium")
PROBE = """<script>setTimeout(() => {
  const plots = [...document.querySelectorAll(".js-plotly-plot")];
  const wide = plots.filter(p => p._fullLayout.width > document.body.clientWidth);
  const drawn = plots.filter(p => p.querySelector("svg, canvas")).length;
  document.body.insertAdjacentHTML("beforeend",
    `<pre>PROBE ${innerWidth} ${document.documentElement.scrollWidth} ${plots.length} ${drawn}`
    + ` ${wide.length} END</pre>`);
}, 2500)</script></body>"""


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    root = tmp_path_factory.mktemp("report")
    log = write_flying_log(root, seconds=6.0)
    done = tagvio("compare", log, "--out", root / "out", "--blackout", "4,1")
    assert done.code == 0, done.err
    return root / "out" / "report.html"


def browse(page, width, *words):
    """What the console said, and what the page is in the end."""
    call = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
            "--hide-scrollbars", "--virtual-time-budget=8000", f"--window-size={width},2400",
            *words, page.as_uri()]  # fmt: skip
    done = subprocess.run(call, capture_output=True, text=True, timeout=120, check=False)
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return [
        c for c in console if "Uncaught" in c or ":ERROR:" in c or "Failed to" in c
    ], done.stdout


@needs_browser
@pytest.mark.parametrize("width", [1200, 500])
def test_it_draws_all_plots_within_the_page(report, tmp_path, width):
    probed = tmp_path / "probed.html"
    probed.write_text(report.read_text().replace("</body>", PROBE))
    errors, page = browse(probed, width, "--dump-dom")
    assert errors == []
    numbers = re.search(r"PROBE (\d+) (\d+) (\d+) (\d+) (\d+) END", page)
    assert numbers, "the page's scripts did not run to their end"
    inner, scroll, plots, drawn, wide = map(int, numbers.groups())
    assert scroll <= inner
    assert plots == drawn >= 8
    assert wide == 0


@needs_browser
def test_in_the_dark_it_is_dark(report, tmp_path):
    light, dark = tmp_path / "light.png", tmp_path / "dark.png"
    browse(report, 900, f"--screenshot={light}")
    browse(report, 900, f"--screenshot={dark}", "--blink-settings=preferredColorScheme=0")
    day, night = (cv2.imread(str(p), cv2.IMREAD_GRAYSCALE) for p in (light, dark))
    assert np.median(day) > 200
    assert np.median(night) < 60
    assert day.std() > 10
    assert night.std() > 10


def test_the_plots_are_written_as_files_on_request(tmp_path):
    log = write_flying_log(tmp_path, seconds=3.0)
    done = tagvio("compare", log, "--out", tmp_path / "out", "--png")
    assert done.code == 0, done.err
    for name in ("errors.png", "trajectory.png"):
        image = cv2.imread(str(tmp_path / "out" / name))
        assert image.shape[1] > 1000
        assert image.std() > 5.0
