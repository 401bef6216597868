"""What begins later or ends earlier than the rest of a log is named with its seconds."""

import pytest
from small_log import write_log

from vio.sources.flight_log.log import FlightLog

FILES = {
    "IMU": "mav0/imu0/data.csv",
    "frames": "mav0/cam0/data.csv",
    "truth": "mav0/state_groundtruth_estimate0/data.csv",
}
CUT = [  # of which file, which of its rows stay, what is said
    ("IMU", slice(0, 60), "the IMU ends 1.3 s before the last frame"),
    ("IMU", slice(160, None), "the IMU begins 1.6 s after the first frame"),
    ("frames", slice(0, 5), "the frames end 1.6 s before the last IMU sample"),
    ("frames", slice(12, None), "the frames begin 1.2 s after the first IMU sample"),
    ("truth", slice(0, 8), "the truth ends 1.2 s before the last frame"),
    ("truth", slice(12, None), "the truth begins 1.2 s after the first frame"),
]


@pytest.mark.parametrize(("what", "rows", "said"), CUT)
def test_what_is_short_is_named(tmp_path, what, rows, said):
    log = write_log(tmp_path)
    path = log / FILES[what]
    head, *lines = path.read_text().splitlines(keepends=True)
    path.write_text(head + "".join(lines[rows]))
    found = [w for w in FlightLog.open(log).warnings if "begin" in w or " end" in w]
    assert found == [f"{log}: {said}"]


def test_what_is_whole_earns_no_word(tmp_path):
    log = FlightLog.open(write_log(tmp_path), blackout=(3.0, 1.5))  # leaves frames out
    assert [w for w in log.warnings if "begin" in w or " end" in w] == []
