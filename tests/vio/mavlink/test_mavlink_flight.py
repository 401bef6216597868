"""The filter on a simulated flight through the companion: what leaves is true and stamped."""

import numpy as np
import pytest
from flights import CAMERA, ErrorStateFilter, ImuSample, PoseNoise, events, feed, fly
from test_mavlink_protocol import beat

from tagvo.records import PoseMeasurement
from vio.config.filter import VioConfig
from vio.config.mavlink import MavlinkConfig
from vio.mavlink.codec import MESSAGE_IDS
from vio.mavlink.protocol import Companion
from vio.sim.sensors.simple_imu import PIXHAWK

HEADING = 60.0
NOISE = PoseNoise(white=(0.01, 0.3), slow=(0.0, 0.0), outliers=0.03, dropouts=0,
                  delay_s=(0.06, 0.08), stamp_s=0.03)  # fmt: skip


def flown(valid_at, seconds=12.0):
    """True flight, and (now, fields) of all poses that left; the camera's stamps are 30 ms off."""
    flight = fly("T3", 2, NOISE, seconds=seconds)
    estimator = ErrorStateFilter(VioConfig(), CAMERA, PIXHAWK)
    config = {"origin": None, "imu": {"message": "none"}, "map_heading_deg": HEADING,
              "valid_at": valid_at}  # fmt: skip
    companion = Companion(MavlinkConfig.model_validate(config), np.eye(3), np.zeros(3), 0,
                          MESSAGE_IDS)  # fmt: skip
    companion.heard(beat(), 0)
    arrivals = {id(pose): t for t, pose in flight.poses}
    left, captures = [], set()
    for what in events(flight):
        feed(estimator, what)
        now = what.arrival_ns if isinstance(what, ImuSample) else arrivals[id(what)]
        captured = isinstance(what, PoseMeasurement)
        wanted = what.t_ns if captured else companion.wanted(now)
        captures |= {what.t_ns // 1000} if captured else set()
        moment = None if wanted is None else estimator.moment(wanted)
        companion.resets.saved(companion.resets.value)
        out = companion.due(now)
        if moment is not None:
            out += companion.offer(moment, estimator.health(), captured, now)
        left += [(now, m.fields) for m in out if m.name == "VISION_POSITION_ESTIMATE"]
    return flight, estimator, left, captures


@pytest.mark.parametrize("valid_at", ["capture", "now"])
def test_what_leaves_is_where_the_vehicle_was_at_its_stamp(valid_at):
    flight, estimator, left, captures = flown(valid_at)
    offset = estimator.state()[20]
    assert offset == pytest.approx(0.03, abs=0.004)
    late = [(now, f) for now, f in left if now > 6e9]
    t = np.array([f["usec"] for _, f in late]) * 1e-6 + offset  # of the IMU's clock: the truth's
    truth = flight.flight(t)
    c, s = np.cos(np.radians(HEADING)), np.sin(np.radians(HEADING))
    north = c * truth.p_WI[:, 0] + s * truth.p_WI[:, 1]
    east = s * truth.p_WI[:, 0] - c * truth.p_WI[:, 1]
    down = -truth.p_WI[:, 2]
    sent = np.array([[f["x"], f["y"], f["z"]] for _, f in late])
    error = np.linalg.norm(sent - np.stack([north, east, down], -1), axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.03
    ahead = truth.R_WI[:, :, 0]  # of the nose
    yaw = np.arctan2(s * ahead[:, 0] - c * ahead[:, 1], c * ahead[:, 0] + s * ahead[:, 1])
    got = np.array([f["yaw"] for _, f in late])
    assert np.degrees(np.abs(np.angle(np.exp(1j * (got - yaw))))).max() < 1.5
    sigma = np.sqrt([f["covariance"][0] for _, f in late])
    assert np.all((sigma > 1e-4) & (sigma < 0.1))
    rate = (len(late) - 1) / (late[-1][0] - late[0][0]) * 1e9
    if valid_at == "capture":
        at_capture = np.mean([f["usec"] in captures for _, f in late])
        assert at_capture > 0.9
        assert 18.0 < rate < 32.0
    else:
        age = np.array([now - f["usec"] * 1000 for now, f in late]) * 1e-6
        assert age.max() < 1.0, "predicted to the very moment"
        assert 28.0 < rate < 32.0
    assert len({f["reset_counter"] for _, f in left}) <= 3
