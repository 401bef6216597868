"""Faults of the link while it flies: restarts, cuts, steps of clocks; in simulated time."""

import numpy as np
import pytest
from fc_ardupilot import ArduPilot
from fc_autopilot import own_error
from fc_px4 import Px4
from fc_vehicle import Vehicle
from fc_world import EPOCH, MS, S, World, moments

VISION = "VISION_POSITION_ESTIMATE"


def world(kind, seed=0):
    rng = np.random.default_rng(seed)
    fc = kind(Vehicle(), rng)
    w = World(fc, rng, with_imu=True, tick_ns=5 * MS if kind is ArduPilot else 4 * MS)
    w.see(moments(fc.vehicle, rng), latency_ms=(60.0, 70.0))
    return w


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
def test_an_autopilot_that_starts_again_gets_all_it_needs(kind, caplog):
    w = world(kind)
    w.run(5.0)
    assert w.fc.arm(w.t) is True
    w.up = False
    w.fc.boot(w.t)  # its memory and its clock begin anew; it takes two seconds to speak
    w.run(7.0)
    w.up = True
    w.run(12.0)
    first = min(t for t, _ in w.fc.heard[VISION] if t > 7.05 * S)  # its restart is heard by then
    assert w.fc.origin is not None
    assert w.fc.origin_ns < first, "the origin first, again"
    assert first < 8.0 * S
    assert 105 in w.fc.streams, "and the IMU's rate"
    assert w.fc.arm(w.t) is True
    assert any("started again" in r.message for r in caplog.records)
    late = [s for s in w.samples if s.arrival_ns - EPOCH > 8 * S]
    assert len(late) > 300
    assert np.abs([s.arrival_ns - s.t_ns for s in late]).max() < 60 * MS


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
def test_a_cut_of_ten_seconds_heals_by_itself(kind, caplog):
    w = world(kind)
    w.run(5.0)
    assert w.fc.arm(w.t) is True
    w.fc.target = np.array([0.0, 0.0, -1.0])
    before = w.companion.resets.value
    w.run(7.0)
    w.up = False
    w.run(17.0)
    w.up = True
    w.run(20.0)
    assert own_error(w.fc) < 0.05
    assert w.fc.fused[-1][0] > 19.9 * S
    assert w.companion.resets.value == before, "nothing of ours has jumped"
    assert any("is silent" in r.message for r in caplog.records)
    assert len([s for s in w.samples if s.arrival_ns - EPOCH > 17.5 * S]) > 0.8 * 200 * 2.5
    stamps = np.array([s.t_ns for s in w.samples])
    assert (np.diff(stamps) > 0).all()
    assert w.companion.counters["autopilot_restarts"] == 0


@pytest.mark.parametrize("kind", [ArduPilot, Px4])
@pytest.mark.parametrize("step_s", [5.0, -5.0])
def test_a_step_of_its_clock_disturbs_no_pose(kind, step_s):
    w = world(kind)
    w.run(5.0)
    w.fc.step_ns = round(step_s * S)
    w.run(9.0)
    times = np.array([t for t, _ in w.poses()])
    gaps = np.diff(times[times > 2 * S])
    assert gaps.max() < 0.3 * S, "at most until the origin is confirmed anew"
    usec = np.array([f["usec"] for _, f in w.poses()])
    assert np.diff(usec).min() > 20_000
    assert w.companion.counters["clock_steps"] == 1


def test_px4_converges_anew_after_its_clock_has_stepped():
    w = world(Px4)
    w.fc.timesync.good = 480
    w.run(4.0)
    assert w.fc.timesync.converged
    w.fc.step_ns = 5 * S
    w.run(5.5)
    assert not w.fc.timesync.converged, "ten bad ones in a row"
    w.fc.timesync.good = 480
    w.run(9.0)
    assert w.fc.timesync.converged
    stamps = {t: m.usec * 1000 - EPOCH for t, m in w.fc.heard[VISION]}
    errors = [(when - w.fc.clock(stamps[t])) / MS for t, when, _ in w.fc.fused if t > 8.5 * S]
    assert len(errors) > 10
    assert np.abs(errors).max() < 3.0


def test_garbage_on_the_wire_harms_nothing():
    w = world(ArduPilot)
    rng = np.random.default_rng(1)
    for k in range(300):
        w.at(k * 10 * MS, lambda: w._to_companion(rng.bytes(int(rng.integers(1, 60)))))
    w.run(4.0)
    assert w.codec.bad > 0
    assert w.fc.arm(w.t) is True
    assert len(w.poses()) > 90
