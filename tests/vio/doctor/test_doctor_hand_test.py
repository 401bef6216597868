"""Wrong axes at headings other than 0 (and at 0): each is named, and what is right is not."""

import numpy as np
import pytest

from vio.doctor.hand_test import Rest, Step, judge, rest

HEADINGS = [0.0, 37.0, 60.0, 90.0, 135.0, 200.0, 300.0]


def walk(heading_deg, report, rng, quarter_deg=80.0, carry=0.5, lift=0.4):
    """Rests of a vehicle moved by a hand: true NED and heading, through what a bridge reports.

    report(p_ned, yaw) -> (p, yaw) as sent. Hands are crooked by some degrees and centimetres.
    """
    p, yaw, rests = np.array([1.0, -2.0, -0.1]), np.radians(heading_deg), {}
    ahead = 0.0

    def settle(step):
        q, psi = report(p + 0.01 * rng.normal(size=3), yaw + 0.02 * rng.normal())
        n = 20
        noisy = q + 0.005 * rng.normal(size=(n, 3))
        rests[step] = rest(noisy, psi + 0.01 * rng.normal(size=n))

    settle(Step.START)
    p = p + np.array([0.03, -0.02, -lift])
    settle(Step.LIFTED)
    for after, turn in ((Step.AHEAD, quarter_deg), (Step.AGAIN, 0.0)):
        ahead = yaw + np.radians(8.0) * rng.normal()
        p = p + np.array([carry * np.cos(ahead), carry * np.sin(ahead), 0.02])
        settle(after)
        yaw += np.radians(turn)
        if turn:
            settle(Step.TURNED)
    return rests


def right(p, yaw):
    return p, yaw


def flu(p, yaw):
    return p * [1, -1, -1], -yaw


def enu(p, yaw):
    return np.array([p[1], p[0], -p[2]]), np.pi / 2 - yaw


FAULTS = {
    "yaw negated": (lambda p, y: (p, -y), {"axis_yaw"}, "negate yaw"),
    "yaw from east": (lambda p, y: (p, np.pi / 2 - y), {"axis_yaw"}, "pi/2 - yaw"),
    "y negated": (lambda p, y: (p * [1, -1, 1], y), {"axis_xy"}, "negate y:"),
    "x negated": (lambda p, y: (p * [-1, 1, 1], y), {"axis_xy"}, "negate x:"),
    "x and y exchanged": (lambda p, y: (p[[1, 0, 2]], y), {"axis_xy"}, "exchange x and y (ENU"),
    "exchanged, negated": (
        lambda p, y: (p[[1, 0, 2]] * [-1, -1, 1], y), {"axis_xy"}, "exchange x and y, negate",
    ),
    "z up": (lambda p, y: (p * [1, 1, -1], y), {"axis_z"}, "negate z"),
    "z and x exchanged": (
        lambda p, y: (p[[2, 1, 0]], y), {"axis_vertical"}, "orientation",
    ),
    "a z-up frame as it is (FLU)": (flu, {"axis_z", "axis_mirrored"}, "convert to NED"),
    "a z-up frame as it is (ENU)": (enu, {"axis_z", "axis_mirrored"}, "convert to NED"),
    "positions of a z-up frame, yaw right": (
        lambda p, y: (enu(p, y)[0], y), {"axis_z", "axis_xy"}, "exchange x and y (ENU",
    ),
    "nose to the left": (lambda p, y: (p, y - np.pi / 2), {"axis_nose"}, "T_BI"),
    "nose behind": (lambda p, y: (p, y + np.pi), {"axis_nose"}, "T_BI"),
}  # fmt: skip


@pytest.mark.parametrize("heading", HEADINGS)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_wrong_axis_is_named_at_any_heading(fault, heading):
    report, codes, remedy = FAULTS[fault]
    for seed in range(4):
        found = judge("it", walk(heading, report, np.random.default_rng(seed)))
        named = {f.code for f in found}
        if codes == {"axis_vertical"}:  # the plane is upright too: more may be said of it
            assert codes <= named
        else:
            assert named == codes
        assert any(remedy in f.do for f in found), [f.do for f in found]


@pytest.mark.parametrize("heading", HEADINGS)
def test_what_is_right_is_not_blamed(heading):
    for seed in range(10):
        assert judge("it", walk(heading, right, np.random.default_rng(seed))) == []


@pytest.mark.parametrize("turned", [0.0, 30.0, 77.0, 120.0, 210.0])
def test_a_map_at_any_heading_is_right(turned):
    """A level frame may lie as it will: positions and yaw turn together."""
    c, s = np.cos(np.radians(turned)), np.sin(np.radians(turned))
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    report = lambda p, y: (R @ p, y + np.radians(turned))  # noqa: E731
    assert judge("it", walk(60.0, report, np.random.default_rng(2))) == []


@pytest.mark.parametrize("keys", [{"lift": 0.05}, {"carry": 0.06}, {"quarter_deg": 12.0}])
def test_small_movements_are_asked_for_again(keys):
    found = judge("it", walk(60.0, right, np.random.default_rng(0), **keys))
    assert {f.code for f in found} == {"wiggle_again"}


def test_carries_that_contradict_each_other_are_asked_for_again():
    """Ahead once, sideways the second time."""
    rests = walk(60.0, right, np.random.default_rng(0))
    turned = rests[Step.TURNED]
    side = turned.yaw + np.radians(85.0)
    moved = turned.p + 0.5 * np.array([np.cos(side), np.sin(side), 0.0])
    rests[Step.AGAIN] = Rest(moved, turned.yaw)
    assert {f.code for f in judge("it", rests)} == {"wiggle_again"}


def test_without_poses_nothing_is_judged():
    assert rest(np.zeros((0, 3)), np.zeros(0)) is None
    moving = np.linspace([0, 0, 0], [1, 0, 0], 30)
    assert rest(moving, np.zeros(30)) is None
    (only,) = judge("it", {Step.START: None})
    assert only.code == "wiggle_again"
    assert "start, lifted" in only.why


def test_a_yaw_at_the_seam_has_a_mean():
    yaws = np.array([np.pi - 0.01, -np.pi + 0.01] * 10)
    assert abs(abs(rest(np.zeros((20, 3)), yaws).yaw) - np.pi) < 1e-9
