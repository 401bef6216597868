"""The filter as others use it: IMU samples and poses in, in any order; the state valid now out."""

from collections import Counter, deque
from statistics import median

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.config import FloorConfig
from tagvo.geometry import Array, BoolArray, IntArray
from tagvo.records import Observations, PoseMeasurement, PosePrior
from tagvo.tags.tag_map import TagMap
from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.calibration_check import RigJudge
from vio.filter.health import Health, Signs, judge
from vio.filter.history import Window
from vio.filter.imu_noise import NoiseMeter, noise_words
from vio.filter.initialization import CalibrationBounds, Rig, begin, dimension, is_still, moves
from vio.filter.measurements.corners import pack
from vio.filter.measurements.pivot import pose_row
from vio.filter.outputs import camera_prior, moment, nav_state
from vio.filter.preprocessing import DEGRADED_NS, ImuIntake, Interval
from vio.filter.relocalization import LostWatch, relocation
from vio.records import ImuNoise, ImuSample, Moment, NavState

_JUDGE_NS = 200_000_000  # how often the calibration is judged
_SLOTS = 256  # measurements that the window remembers
_START_NS = 1_500_000_000  # how far back the start looks
_AGAIN_NS = 10_000_000_000  # a reset so soon after a start or a reset: what it kept was wrong
VERDICTS = {
    at.PENDING: "waiting",
    at.ACCEPTED: "fused",
    at.POSITION_ONLY: "fused_position",
    at.ROTATION_ONLY: "fused_rotation",
    at.REJECTED: "gated",
    at.SINGULAR: "singular",
}

TAKEN = ("fused",)  # a half alone counts as neither taken nor refused
REFUSED = ("gated", "singular", "too_old", "too_early", "duplicate")
# a Pixhawk's over MAVLink: where a log has no imu.yaml
USUAL_NOISE = ImuNoise(5e-3, 5e-4, 3e-4, 2e-5)


def process_noise(noise: ImuNoise, config: VioConfig) -> Array:
    """The vector q of `layout` from an IMU's densities and the configuration; (NOISE,)."""
    sigma = [noise.gyro_density, noise.accel_density, noise.gyro_walk, noise.accel_walk]
    sigma += [config.extrinsic_walk_rad, config.time_offset_walk_s]
    return np.append(np.square(sigma), [1.0 / config.pose_bias_time_s, config.gravity_m_s2])


def _either(states: IntArray, a: int, b: int) -> BoolArray:
    return np.asarray((states == a) | (states == b))


class Estimator:
    """Error-state filter with a memory; `imu`, `pose`, `corners` feed it, nothing reads a clock."""

    def __init__(
        self,
        config: VioConfig,
        camera: Camera,
        noise: ImuNoise,
        tag_map: TagMap | None = None,
        floor: FloorConfig | None = None,
    ) -> None:
        R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
        self._config, self._map = config, tag_map
        self._centre_px, self._floor = camera.intrinsics[2:], floor or FloorConfig()
        self._rig = Rig(R_IC, p_IC, camera.timeshift_s)
        known = tag_map.gravity if tag_map is not None else None
        self._gravity = (
            None if known is None else (np.array(known.dir), float(np.radians(known.sigma_deg)))
        )
        rate = noise.rate_hz or 200.0
        ticks = int(np.ceil((config.buffer_s + 0.5) * max(rate, 100.0) * 1.5))
        tags = config.max_tags if config.update == "corners" else 0
        width = 2 + max(at.POSE_NUMBERS, tags * at.TAG_NUMBERS)
        share = -1.0 if config.pose_bias_share is None else config.pose_bias_share
        par = np.array([config.r_inflation, config.gate, float(config.r_adapt), share])
        q = process_noise(noise, config)
        self._window = Window(dimension(config), ticks, _SLOTS, width, q, par)
        stated = np.repeat([noise.gyro_density, noise.accel_density], 3)
        meter = NoiseMeter(stated, config.vibration, 1.0 / rate)
        limits = config.gyro_max_rad_s, config.accel_max_m_s2
        self._intake = ImuIntake(1.0 / rate, *limits, meter)
        self._intervals: deque[Interval] = deque()
        self._poses: deque[PoseMeasurement] = deque(maxlen=64)
        self._counters: Counter[str] = Counter()
        self._started = self._on_ground = False
        self._started_once = False
        self._waiting: tuple[str, ...] = ("no_imu", "no_pose")
        self._accepted_ns = self._rejects = self._newest_ns = 0
        self._nis = 0.0
        self._newest_nis = np.nan
        self._still_ns = self._judged_ns = 0
        self._resets = 0
        self._begun_ns = self._turned_ns = 0  # newest start or reset; newest pose taken whole
        self._lost = LostWatch(config.recovery)
        self._distrust: tuple[str, ...] = ()
        self._bounds = CalibrationBounds(config.prior, self._rig)
        self._judge = self._new_judge()

    def _new_judge(self) -> RigJudge:
        return RigJudge(self._config, self._rig.R_IC, self._rig.time_offset_s)

    def imu(self, sample: ImuSample) -> NavState | None:
        """Take an IMU sample; the state valid at its stamp, None before the start."""
        intervals, lost = self._intake.take(sample)
        if lost:
            self._restart("imu_lost")
        for step in intervals:
            self._take(step)
        if not intervals or not self._started:
            return None
        return self.nav()

    def _take(self, step: Interval) -> None:
        self._intervals.append(step)
        while self._intervals[-1].t_ns - self._intervals[0].t_ns > _START_NS:
            self._intervals.popleft()
        if not self._started:
            self._try_start()
            return
        w = self._window
        waiting = w.count > 0 and w.m_state[w.count - 1] == at.PENDING
        w.add_interval(step.t_ns, step.gyro, step.accel, step.scale)
        if self._on_ground and step.t_ns - self._still_ns > self._config.still_every_s * 1e9:
            self._stand_still(step.t_ns)
        if step.t_ns - self._judged_ns > _JUDGE_NS:
            self._judge_rig(step.t_ns)
        if waiting:
            self._review()

    def _judge_rig(self, t_ns: int) -> None:
        """Ask the judge, about a state that nothing late can change: order leaves no trace."""
        self._judged_ns, w = t_ns, self._window
        tick = w.at_or_before(t_ns - round(self._config.buffer_s * 1e9))
        if tick < 0:
            return
        for row in self._judge.rows(w.X[tick], w.P[tick]):
            self._counters["rig_doubted" if row[0] == at.M_OPEN else "rig_confirmed"] += 1
            self._insert(t_ns - round(w.X[tick, at.X_TD] * 1e9), row)

    def pose(self, measured: PoseMeasurement) -> None:
        """Take a camera pose, however late; its stamp is the camera's."""
        if self._remember(measured):
            self._insert(measured.t_ns, pose_row(measured))
            self._review()

    def corners(self, t_ns: int, seen: Observations, measured: PoseMeasurement | None) -> None:
        """Take the tags of one frame; the pose of the same frame serves start and recovery."""
        if self._map is None:
            raise ValueError("the corner update needs the tag map")
        if measured is not None:
            self._remember(measured)
        if not self._started:
            return
        tags = pack(seen, self._map, self._centre_px, self._floor, self._config.max_tags)
        if len(tags):
            self._insert(t_ns, np.concatenate([[at.M_CORNERS, len(tags)], tags.ravel()]))
            self._review()

    def ground(self, on_ground: bool) -> None:
        """Say whether the vehicle stands on the ground (disarmed or landed): then it is still."""
        self._on_ground = on_ground

    def nav(self) -> NavState | None:
        """The state valid at the newest IMU sample, None before the start."""
        if not self._started:
            return None
        w = self._window
        return nav_state(w.now_ns, w.X[w.last], w.P[w.last])

    def moment(self, t_ns: int | None = None) -> Moment | None:
        """The filter at a stamp of the camera's clock, None: at its newest sample, for a vehicle.

        None before the start, for a stamp beyond its memory, and 50 ms ahead of the IMU.
        """
        return moment(self._window, t_ns) if self._started else None

    def prior(self, t_ns: int) -> PosePrior | None:
        """Where the camera is at a stamp of its clock, with the prediction's covariance."""
        if not self._started:
            return None
        return camera_prior(self._window, t_ns)

    def state(self) -> Array | None:
        """The whole nominal state now (see `layout`), None before the start."""
        return self._window.X[self._window.last].copy() if self._started else None

    def covariance(self) -> Array | None:
        """The whole error covariance now (n, n), None before the start."""
        return self._window.P[self._window.last].copy() if self._started else None

    @property
    def nis(self) -> float:
        """Normalised innovation squared of the newest frame judged, per degree of freedom; NaN."""
        return self._newest_nis

    @property
    def noise_words(self) -> str | None:
        """What to say of an IMU that is far noisier than its file states; None: it is not."""
        return noise_words(self._intake.meter.largest, self._intake.meter.stated)

    @property
    def counters(self) -> dict[str, int]:
        """How often each thing has happened, measurements by verdict among them."""
        out = Counter(self._intake.counters) + self._counters
        out.update({VERDICTS[k]: v for k, v in self._window.verdicts().items() if v})
        return dict(sorted(out.items()))

    def health(self) -> Health:
        """State with reasons, judged at the newest IMU sample."""
        if not self._started:
            config = self._config.health
            return judge(None, self._resets, self._waiting, config, self._distrust)
        w = self._window
        P = w.P[w.last]
        sigma_m = float(np.sqrt(np.diag(P)[at.P : at.P + 3].max()))
        sigma_deg = float(np.degrees(np.sqrt(np.diag(P)[at.TH : at.TH + 3].max())))
        degraded = self._intake.degraded_at_ns
        recent = degraded is not None and w.now_ns - degraded < 10 * DEGRADED_NS
        age = max(0.0, (w.now_ns - self._accepted_ns) * 1e-9)
        ahead = self._newest_ns + round(w.X[w.last, at.X_TD] * 1e9) - w.now_ns
        late_s = max(0.0, ahead * 1e-9)
        far = self._bounds.calibration_far(w.X[w.last])
        signs = Signs(age, self._rejects, self._nis, sigma_m, sigma_deg, recent, late_s, far)
        return judge(signs, self._resets, (), self._config.health, self._distrust)

    def distrust(self, *reasons: str) -> None:
        """Say why the filter is LOST whatever it says of itself; nothing: it is not."""
        self._distrust = reasons

    def _remember(self, measured: PoseMeasurement) -> bool:
        """Keep a pose for start and recovery; whether it is still to be fused."""
        sound = (np.isfinite(a).all() for a in (measured.p_WC, measured.R_WC, measured.cov))
        if not all(sound):
            self._counters["pose_not_finite"] += 1
            return False
        self._poses.append(measured)
        self._newest_ns = max(self._newest_ns, measured.t_ns)
        if self._started:
            return True
        self._try_start()
        return False

    def _insert(self, t_ns: int, row: Array) -> None:
        shift = round(self._window.X[self._window.last, at.X_TD] * 1e9)
        late = self._window.now_ns - (t_ns + shift)
        limit = self._config.buffer_s * 1e9
        why = "too_old" if late > limit else "too_early" if late < -limit else ""
        why = why or self._window.insert(t_ns, row)
        if why:
            self._counters[why] += 1

    def _stand_still(self, t_ns: int) -> None:
        self._still_ns = t_ns
        w = self._window
        recent = [p for p in self._poses if p.t_ns > self._newest_ns - _START_NS]
        if moves(recent):  # on a lift, a boat, in a hand that is very calm
            self._counters["still_vetoed"] += 1
            return
        stamp = t_ns - round(w.X[w.last, at.X_TD] * 1e9)
        self._insert(stamp, np.array([at.M_STILL, 1.0, self._config.still_sigma_m_s**2]))

    def _try_start(self) -> None:
        """Start from the newest poses, once there are enough of them inside the IMU's reach."""
        c, shift = self._config.start, round(self._rig.time_offset_s * 1e9)
        self._waiting = ("no_imu",) if not self._intervals else ("no_pose",)
        if not self._intervals or not self._poses:
            return
        first, last = self._intervals[0].t0_ns, self._intervals[-1].t_ns
        inside = {p.t_ns: p for p in self._poses if first <= p.t_ns + shift <= last}
        poses = [inside[t] for t in sorted(inside)]
        steps = list(self._intervals)
        if is_still(steps, self._config) and (last - first) < c.still_s * 1e9:
            self._waiting = ("still_window",)
            return
        if len(poses) < c.poses or poses[-1].t_ns - poses[0].t_ns < c.span_s * 1e9:
            return
        found = begin(poses, steps, self._rig, self._config, self._gravity)
        if found is None:
            self._waiting = ("poses_disagree_with_imu",)
            self._counters["start_refused"] += 1
            self._poses.popleft()
            return
        anew = [p.t_ns for p in self._poses if p.t_ns >= poses[0].t_ns]
        self._window.start(found.t_ns, found.x, found.P, anew)
        for s in steps:
            if s.t_ns > found.t_ns:
                self._window.add_interval(s.t_ns, s.gyro, s.accel, s.scale)
        self._counters["start_tilted"] += int(found.tilt_rad > 0.0)
        self._resets += self._started_once
        self._judge = self._new_judge()
        self._started = self._started_once = True
        self._accepted_ns = self._still_ns = self._judged_ns = found.t_ns
        self._begun_ns = self._turned_ns = found.t_ns
        self._lost.clear()
        for pose in sorted(self._poses, key=lambda p: p.t_ns):
            if pose.t_ns >= poses[0].t_ns:
                self._insert(pose.t_ns, pose_row(pose))
        self._review()

    def _restart(self, why: str) -> None:
        self._started = False
        self._intervals.clear()
        self._poses.clear()
        self._waiting = (why,)
        self._counters["restarts"] += 1

    def _review(self) -> None:
        """After measurements were decided: what health needs, and whether to recover."""
        w, c = self._window, self._config.recovery
        states = w.m_state[: w.count]
        vision = np.flatnonzero((w.m_z[: w.count, 0] <= at.M_CORNERS) & (states != at.PENDING))
        whole = vision[states[vision] == at.ACCEPTED]
        if whole.size:
            self._turned_ns = int(w.m_at[whole[-1]])
        good = vision[_either(states[vision], at.ACCEPTED, at.POSITION_ONLY)]
        lately = good[w.m_at[good] - self._turned_ns < c.turned_after_s * 1e9]
        if lately.size:  # a position alone counts while a whole pose stands behind it
            self._accepted_ns = int(w.m_at[lately[-1]])
        bad = vision[vision > (good[-1] if good.size else -1)]
        self._rejects = len(bad)
        nis = w.m_nis[vision[-20:]]
        self._nis = median(nis.tolist()) / 6.0 if nis.size else 0.0
        self._newest_nis = float(nis[-1]) / 6.0 if nis.size else np.nan
        believed_ns = int(w.m_at[good[-1]]) if good.size else self._accepted_ns
        age = (w.now_ns - believed_ns) * 1e-9
        if not self._distrust and self._lost.asks(self.health(), w.now_ns, self._newest_ns):
            self._counters["lost_restarts"] += 1
            self._begin_again(list(self._poses)[-len(bad) :] if bad.size else list(self._poses))
        elif len(bad) >= c.rejects and age > c.after_s:
            self._recover(w.m_t[bad[-c.rejects :]])
        else:
            self._review_rotations(vision, states)

    def _review_rotations(self, vision: IntArray, states: IntArray) -> None:
        """Recover where positions pass and rotations do not, pose after unambiguous pose."""
        w, c = self._window, self._config.recovery
        good = vision[_either(states[vision], at.ACCEPTED, at.ROTATION_ONLY)]
        later = vision[vision > (good[-1] if good.size else -1)]
        if len(later) < c.turned:
            return
        clear = {p.t_ns for p in self._poses if "ambiguous" not in p.flags}
        turned = [int(t) for t in w.m_t[later] if int(t) in clear]
        if len(turned) < c.turned:
            return
        self._rejects = max(self._rejects, len(turned))
        if (turned[-1] - turned[0]) * 1e-9 > c.turned_after_s:
            self._recover(np.array(turned[-c.rejects :]))

    def _recover(self, stamps: IntArray) -> None:
        """Move to the rejected poses where they agree; the history before is forgotten."""
        known = {p.t_ns: p for p in self._poses}
        poses = [known[t] for t in stamps.tolist() if t in known]
        if len(poses) < self._config.recovery.rejects:
            return
        w = self._window
        soon = w.now_ns - self._begun_ns < _AGAIN_NS
        if soon or self._bounds.implausible(w.X[w.last]):
            self._begin_again(poses)
            return
        move = relocation(w, poses, self._config.recovery)
        if move is None:
            self._counters["recovery_refused"] += 1
            return
        self._resume(*move, poses[-1].t_ns)

    def _resume(self, tick: int, x: Array, P: Array, stamp_ns: int) -> None:
        """Begin anew at a snapshot with another state, and integrate up to now."""
        w = self._window
        t0, later = int(w.t[tick]), list(range(tick + 1, w.last + 1))
        t, imu = w.t[later].copy(), w.imu[later].copy()
        w.start(t0, x, P)
        for i in range(len(later)):
            w.add_interval(int(t[i]), imu[i, 0:3], imu[i, 3:6], imu[i, 6:12])
        self._resets += 1
        self._rejects = 0
        self._accepted_ns = self._turned_ns = stamp_ns
        self._begun_ns = w.now_ns
        self._lost.clear()
        self._counters["resets"] += 1

    def _begin_again(self, poses: list[PoseMeasurement]) -> None:
        """Forget state and priors, start from these poses: what has failed twice is not kept."""
        self._started, self._waiting = False, ("begins_again",)
        self._counters["restarts"] += 1
        self._rejects = 0
        self._poses = deque(poses, maxlen=self._poses.maxlen)
        self._try_start()
