"""The filter on a real hand-held log, one configuration: errors at every moment of truth, NEES."""

import os
from pathlib import Path

import numpy as np
import pytest

from vio.config import Config
from vio.config.filter import VioConfig
from vio.evaluate.metrics import now_errors, stats
from vio.evaluate.records import Window
from vio.evaluate.truth import clean_truth
from vio.localize.localizer import Localizer
from vio.localize.run import run, trajectory
from vio.sources.flight_log.log import FlightLog

DATA = os.environ.get("TAGVIO_DATA")
pytestmark = pytest.mark.skipif(DATA is None, reason="TAGVIO_DATA is not set")
FOUR = [14, 15, 20, 21]
ROWS = {  # given: options, position rms [m] and rotation rms [deg] at most
    "four": ({"only_tags": FOUR}, 0.0115, 0.45),
    "four, every 4th": ({"only_tags": FOUR, "every": 4}, 0.012, 0.46),
    "tag 14": ({"only_tags": [14]}, 0.0245, 0.50),
    "four, blackouts": ({"only_tags": FOUR, "blackout": (3.0, 1.0)}, 0.014, 0.46),
}


@pytest.mark.parametrize("update", ["pose", "corners"])
@pytest.mark.parametrize("row", ROWS)
def test_errors_on_a_hand_held_log(row, update):
    options, position, rotation = ROWS[row]
    log = FlightLog.open(Path(DATA) / "euroc_imu_april", use_detections=True, **options)
    config = Config(vio=VioConfig(update=update))
    result = run(log.events(), Localizer(log.camera, log.tag_map, config, log.imu_noise))
    window = Window(log.t0_ns + 8_000_000_000, log.end_ns)
    truth = clean_truth(log.truth)
    figures = stats(now_errors(trajectory("vio", result.outputs["vio"]), truth, window))
    assert figures["position_rmse_m"] < position
    assert figures["rotation_rmse_deg"] < rotation
    assert 0.4 < figures["nees_pose"] < 3.0
    assert figures["coverage"] == 1.0
    assert np.isfinite(list(figures.values())).all()
