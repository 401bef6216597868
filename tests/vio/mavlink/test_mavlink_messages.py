"""What is in the messages: through real frames and pymavlink's own decoder, by its enums."""

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as m
from scipy.spatial.transform import Rotation

from vio.filter.health import Health, State
from vio.frames import NedPose
from vio.mavlink import messages
from vio.mavlink.codec import MESSAGE_IDS, Codec

RNG = np.random.default_rng(4)
A = RNG.normal(size=(9, 9)) * 0.1
COV = A @ A.T
ROTATION = Rotation.from_euler("ZYX", [2.0, 0.3, -0.4])
POSE = NedPose(
    np.array([1.0, -2.0, -3.0]), ROTATION.as_matrix(), np.array([0.4, 0.5, -0.6]),
    np.array([0.1, 0.2, 0.3]), COV,
)  # fmt: skip
T_NS = 123_456_789_123_456


def sent(message):
    """The message as its receiver has it."""
    frame = Codec(1, 197).encode(message)
    assert frame[0] == 0xFD, "MAVLink 2"
    (got,) = m.MAVLink(None).parse_buffer(frame)
    assert got.get_type() == message.name
    assert (got.get_srcSystem(), got.get_srcComponent()) == (1, 197)
    return got


def test_the_numbers_are_mavlinks():
    names = {
        "LOCAL_NED": m.MAV_FRAME_LOCAL_NED, "BODY_FRD": m.MAV_FRAME_BODY_FRD,
        "LOCAL_FRD": m.MAV_FRAME_LOCAL_FRD, "ARDUPILOT": m.MAV_AUTOPILOT_ARDUPILOTMEGA,
        "PX4": m.MAV_AUTOPILOT_PX4, "NO_AUTOPILOT": m.MAV_AUTOPILOT_INVALID,
        "ONBOARD_CONTROLLER": m.MAV_TYPE_ONBOARD_CONTROLLER, "BOOT": m.MAV_STATE_BOOT,
        "ACTIVE": m.MAV_STATE_ACTIVE, "CRITICAL": m.MAV_STATE_CRITICAL,
        "TERMINATION": m.MAV_STATE_FLIGHT_TERMINATION, "WARNING": m.MAV_SEVERITY_WARNING,
        "INFO": m.MAV_SEVERITY_INFO, "VIO_ESTIMATOR": m.MAV_ESTIMATOR_TYPE_VIO,
        "SET_MESSAGE_INTERVAL": m.MAV_CMD_SET_MESSAGE_INTERVAL,
        "REQUEST_MESSAGE": m.MAV_CMD_REQUEST_MESSAGE,
        "GPS_GLOBAL_ORIGIN_ID": m.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
        "AUTOPILOT_COMPONENT": m.MAV_COMP_ID_AUTOPILOT1,
    }  # fmt: skip
    assert {name: getattr(messages, name) for name in names} == names
    assert MESSAGE_IDS["HIGHRES_IMU"] == 105
    assert m.MAV_COMP_ID_VISUAL_INERTIAL_ODOMETRY == 197


def test_vision_position_estimate():
    got = sent(messages.vision_position_estimate(T_NS, POSE, 9))
    assert got.usec == T_NS // 1000
    np.testing.assert_allclose([got.x, got.y, got.z], POSE.p_NB, rtol=1e-6)
    np.testing.assert_allclose([got.yaw, got.pitch, got.roll], [2.0, 0.3, -0.4], rtol=1e-6)
    np.testing.assert_allclose(got.covariance, COV[:6, :6][np.triu_indices(6)], rtol=1e-6)
    assert got.reset_counter == 9


def test_variances_not_sigmas_and_at_their_places():
    sigma = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
    pose = NedPose(POSE.p_NB, POSE.R_NF, cov=np.diag(sigma**2))
    got = sent(messages.vision_position_estimate(0, pose, 0)).covariance
    assert len(got) == 21
    np.testing.assert_allclose([got[k] for k in (0, 6, 11, 15, 18, 20)], sigma**2, rtol=1e-6)


@pytest.mark.parametrize("bad", [None, np.full((6, 6), np.nan), np.diag([1, 1, np.inf, 1, 1, 1.0])])
def test_a_covariance_that_is_not_known_is_21_times_nan(bad):
    pose = NedPose(POSE.p_NB, POSE.R_NF, cov=bad)
    for message in (
        messages.vision_position_estimate(0, pose, 0).fields["covariance"],
        messages.odometry(0, pose, 0, 1, 100).fields["pose_covariance"],
        messages.odometry(0, pose, 0, 1, 100).fields["velocity_covariance"],
    ):
        assert len(message) == 21
        assert np.isnan(message).all()
    got = sent(messages.vision_position_estimate(0, pose, 0))
    assert np.isnan(got.covariance).all()


def test_odometry():
    got = sent(messages.odometry(T_NS, POSE, 200, messages.LOCAL_NED, 100))
    assert (got.time_usec, got.frame_id, got.child_frame_id) == (T_NS // 1000, 1, 12)
    w, x, y, z = got.q
    assert abs(np.linalg.norm(np.float32(got.q)) - 1.0) < 1e-5
    back = Rotation.from_quat([x, y, z, w])
    assert (back * ROTATION.inv()).magnitude() < 1e-6
    np.testing.assert_allclose(back.apply([got.vx, got.vy, got.vz]), POSE.v_NB, atol=1e-6)
    np.testing.assert_allclose([got.rollspeed, got.pitchspeed, got.yawspeed], POSE.w_F, rtol=1e-6)
    np.testing.assert_allclose(got.pose_covariance, COV[:6, :6][np.triu_indices(6)], rtol=1e-6)
    linear = [got.velocity_covariance[k] for k in (0, 1, 2, 6, 7, 11)]
    assert np.isfinite(linear).all()
    assert np.isnan([got.velocity_covariance[k] for k in (3, 15, 18, 20)]).all()
    assert (got.reset_counter, got.estimator_type, got.quality) == (200, 3, 100)


def test_odometry_without_velocity_says_nan():
    still = NedPose(POSE.p_NB, POSE.R_NF)
    got = sent(messages.odometry(T_NS, still, 0, messages.LOCAL_FRD, 100))
    assert np.isnan([got.vx, got.vy, got.vz, got.rollspeed, got.pitchspeed, got.yawspeed]).all()
    assert messages.vision_speed_estimate(0, still, 0) is None


def test_vision_speed_estimate():
    got = sent(messages.vision_speed_estimate(T_NS, POSE, 3))
    np.testing.assert_allclose([got.x, got.y, got.z], POSE.v_NB, rtol=1e-6)
    np.testing.assert_allclose(np.reshape(got.covariance, (3, 3)), COV[6:, 6:], rtol=1e-5)
    assert (got.usec, got.reset_counter) == (T_NS // 1000, 3)


def test_each_family_gets_the_frame_that_it_takes():
    assert messages.odometry_frame(m.MAV_AUTOPILOT_ARDUPILOTMEGA) == 20
    assert messages.odometry_frame(m.MAV_AUTOPILOT_PX4) == 1


def test_heartbeat_and_what_it_says():
    got = sent(messages.heartbeat(messages.ACTIVE))
    assert (got.type, got.autopilot, got.system_status) == (18, 8, 4)
    health = {s: messages.system_status(Health(s, (), None, 0)) for s in State}
    assert health == {
        State.INIT: 1, State.TRACKING: 4, State.COASTING: 5, State.RELOCATING: 5, State.LOST: 8,
    }  # fmt: skip
    assert messages.system_status(None) == 1


@pytest.mark.parametrize("length", [0, 1, 49, 50, 51, 99, 100, 101, 150])
def test_texts_come_whole_out_of_their_chunks(length):
    text = "".join(chr(97 + k % 26) for k in range(length))
    got = [sent(one) for one in messages.statustext(text, 6, 31)]
    assert "".join(one.text for one in got) == text
    assert all(len(one.text) <= 50 for one in got)
    assert [one.chunk_seq for one in got] == list(range(len(got)))
    if len(got) == 1:
        assert got[0].id == 0
        assert length <= 50
    else:
        assert {one.id for one in got} == {31}
        assert all(len(one.text) == 50 for one in got[:-1])
        assert len(got[-1].text) < 50, "a chunk that is not full ends the text"


def test_letters_that_mavlink_has_not_do_not_break_a_text():
    (got,) = (sent(one) for one in messages.statustext("3° off", 4, 1))
    assert got.text == "3? off"


def test_origin_and_commands():
    got = sent(messages.set_gps_global_origin(7, 47.397742, -8.545594, 488.0))
    assert (got.target_system, got.latitude, got.longitude, got.altitude) == (
        7, 473977420, -85455940, 488000,
    )  # fmt: skip
    got = sent(messages.command(7, 511, 105, 5000))
    assert (got.target_system, got.target_component, got.command) == (7, 1, 511)
    assert [got.param1, got.param2, got.param3, got.param7] == [105, 5000, 0, 0]
    got = sent(messages.timesync(-5, 2**62))
    assert (got.ts1, got.tc1) == (-5, 2**62)
