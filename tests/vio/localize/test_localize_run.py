"""The loop: what it counts, in which order it feeds, and what is left when it is stopped."""

import gc
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_calls import rendered_log
from flying_log import write_flying_log
from numba.core.registry import CPUDispatcher
from simulated import DOWN, grid_map, pinhole, shot

from tagvo import geometry as geo
from tagvo.pipeline import TagVO
from tagvo.records import Detections, Frame
from vio.localize.baselines import VoOnly
from vio.localize.localizer import Localizer
from vio.localize.run import run, trajectory, tum_rows
from vio.localize.stopwatch import Stopwatch
from vio.localize.warmup import warm_up
from vio.records import ImuSample, NavState

EMPTY = Detections.of(np.zeros(0, dtype=np.int64), np.zeros((0, 4, 2)))


class Spied(Localizer):
    """A localizer that keeps what it is given and answers samples at once."""

    def __init__(self):
        super().__init__(pinhole(), grid_map())
        self.seen = []

    def imu(self, sample):
        self.seen.append(("imu", sample.t_ns))
        return NavState(sample.t_ns, np.zeros(3), np.eye(3), known_ns=sample.arrival_ns)

    def fuse(self, frame, measured, seen=None):
        self.seen.append(("frame" if measured else "blind", frame.t_ns))


class Beside:
    """What a comparison sets beside it, which keeps what it is given."""

    name = "beside"

    def __init__(self):
        self.seen = []

    def pose(self, frame, measured):
        self.seen.append(("frame" if measured else "blind", frame.t_ns))


@pytest.fixture(scope="module")
def vo():
    return TagVO(pinhole(), grid_map())


def frame(vo, t_ns):
    rng = np.random.default_rng(0)
    p_WC = np.array([0.0, 0.0, 0.8])
    true = shot(vo.tag_map, vo.camera, DOWN, p_WC, rng, noise_px=0.0, lay=False)
    return Frame(t_ns, detections=true.frame.detections)


def sample(t_ns):
    return ImuSample(t_ns, np.zeros(3), np.zeros(3), t_ns + 1)


def test_every_event_reaches_all_in_the_order_of_the_source(vo):
    spied, beside, steps = Spied(), Beside(), []
    events = [sample(1), frame(vo, 2), sample(3), Frame(4, detections=EMPTY), sample(5)]
    result = run(events, spied, [beside], each_frame=lambda: steps.append(1))
    order = [("imu", 1), ("frame", 2), ("imu", 3), ("blind", 4), ("imu", 5)]
    assert spied.seen == order
    assert beside.seen == [one for one in order if one[0] != "imu"]
    assert len(steps) == result.frames == 2
    assert (result.with_pose, result.imu) == (1, 3)
    assert result.reasons == {"no_tags": 1}
    assert result.tags_t_ns == [2, 4]
    assert result.tags_count[1] == 0 < result.tags_count[0]
    assert [o.t_ns for o in result.outputs["vio"]] == [1, 3, 5]


def test_ctrl_c_ends_the_loop_and_keeps_what_came(vo):
    def events():
        yield frame(vo, 1)
        yield frame(vo, 2)
        raise KeyboardInterrupt

    result = run(events(), Localizer(vo.camera, vo.tag_map, imu=False), [VoOnly(vo.camera)])
    assert result.interrupted
    assert list(result.outputs) == ["vo"]
    assert [o.t_ns for o in result.outputs["vo"]] == [1, 2]


def test_trajectories_keep_the_order_of_arrival_and_tum_rows_that_of_time():
    R = [geo.exp(np.array([0.0, 0.0, a])) for a in (0.1, 0.2, 0.3)]
    outputs = [
        NavState(t, np.full(3, t), R[i], known_ns=k)
        for i, (t, k) in enumerate([(5, 6), (3, 7), (5, 8)])
    ]
    one = trajectory("x", outputs)
    assert one.t_ns.tolist() == [5, 3, 5]
    assert one.known_ns.tolist() == [6, 7, 8]
    t_ns, p_WI, q_WI = tum_rows(one)
    assert t_ns.tolist() == [3, 5, 5]
    np.testing.assert_allclose(geo.matrix_from_quat(q_WI), [R[1], R[0], R[2]], atol=1e-12)
    assert p_WI[:, 0].tolist() == [3, 5, 5]


def test_velocity_and_covariance_are_kept_only_where_every_output_has_them():
    full = NavState(1, np.zeros(3), np.eye(3), np.ones(3), np.eye(9))
    bare = NavState(2, np.zeros(3), np.eye(3))
    assert trajectory("x", [full, full]).v_WI.shape == (2, 3)
    assert trajectory("x", [full, full]).cov.shape == (2, 6, 6)
    mixed = trajectory("x", [full, bare])
    assert mixed.v_WI is None
    assert mixed.cov is None
    empty = trajectory("x", [])
    assert empty.p_WI.shape == (0, 3)
    assert empty.R_WI.shape == (0, 3, 3)


@pytest.mark.parametrize("size", [(64, 48), (640, 480), (4000, 3000)])
def test_the_warm_up_gives_a_pose_whatever_the_camera_and_the_filters(size):
    from tagvo.config import FilterConfig, TagvoConfig

    width, height = size
    strict = FilterConfig.model_validate({"min_side_px": 1000.0, "edge_px": 100.0})
    for pose in ("joint", "fused"):
        config = TagvoConfig(pose=pose, filters=strict)
        made = warm_up(pinhole(0.8 * width, width, height), config)
        np.testing.assert_allclose(made.p_WC, [0.0, 0.0, 1.0], atol=1e-6)


def test_the_stopwatch_measures_each_stage_and_the_whole():
    watch = Stopwatch()
    for _ in range(3):
        watch.start()
        watch.lap("detect")
        watch.lap("joint")
        watch.stop()
    times = watch.summary()
    assert list(times) == ["detect", "joint", "total"]
    assert all(0.0 <= t["p50"] <= t["p99"] for t in times.values())
    assert times["total"]["p99"] >= times["joint"]["p50"]
    assert Stopwatch().summary() == {}


def test_asked_to_stop_it_ends_between_events(vo):
    spied, said = Spied(), iter([False, False, True])
    events = [sample(1), frame(vo, 2), sample(3), sample(4)]
    result = run(events, spied, stop=lambda: next(said))
    assert result.interrupted
    assert (result.imu, result.frames, len(spied.seen)) == (1, 1, 2)


def compiled_signatures():
    """Every compiled function of the packages with its signatures."""
    functions = {id(f): f for f in gc.get_objects() if isinstance(f, CPUDispatcher)}.values()
    ours = [f for f in functions if f.py_func.__module__.split(".")[0] in ("tagvo", "vio")]
    return {f"{f.py_func.__module__}.{f.py_func.__name__}": set(f.signatures) for f in ours}


def test_after_the_warm_up_a_run_compiles_nothing(tmp_path, tmp_path_factory):
    """In a process of its own: others of these tests have compiled what they wanted.

    Corners of a file, and images searched by either library and tracked: what a detector gives may
    lie otherwise in memory, and is compiled for anew.
    """
    log, seen = write_flying_log(tmp_path, seconds=3.0), rendered_log(tmp_path_factory)
    here = Path(__file__).parent
    code = f"""
import sys
sys.path[:0] = {[str(p) for p in (here, here.parent, here.parents[1], here.parents[2] / "tools")]!r}
import vio.offline.replay as replay
from cli_calls import tagvio
from test_localize_run import compiled_signatures
inner = replay.run
def spied(*args, **more):
    before = compiled_signatures()
    result = inner(*args, **more)
    after = compiled_signatures()
    new = [name for name in after if after[name] != before.get(name, set())]
    assert len(before) > 30 and not new, new
    spied.times = getattr(spied, "times", 0) + 1
    return result
replay.run = spied
log, seen = {str(log)!r}, {str(seen)!r}
for log, words in (
    (log, []),
    (log, ["vio.update=corners"]),
    (log, ["tagvo.ambiguity=prior"]),
    (seen, []),
    (seen, ["tagvo.track.mode=on"]),
    (seen, ["tagvo.pose=fused"]),
):
    words = [w for s in words for w in ("--set", s)]
    done = tagvio("run", log, "--out", {str(tmp_path / "out")!r}, *words)
    assert done.code == 0, done.err
assert spied.times == 6
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
