"""The error-state Kalman filter: IMU samples and poses in, in any order; the state now out."""

from collections import Counter, deque
from statistics import median

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.config import IntrinsicsErrorConfig
from tagvo.geometry import Array, IntArray
from tagvo.records import Observations, PoseMeasurement, PosePrior
from tagvo.tags.tag_map import TagMap
from vio.config.filter import VioConfig
from vio.filter import state as at
from vio.filter.calibration_check import CalibrationCheck
from vio.filter.health import Health, Signs, judge
from vio.filter.history import History, Judged
from vio.filter.imu_noise import NoiseMeter, noise_words
from vio.filter.initialization import CalibrationBounds, Rig, begin, is_still, moves
from vio.filter.measurements import constraints, corners, kinds, pose
from vio.filter.noise_model import model_of
from vio.filter.outputs import camera_prior, moment, nav_state
from vio.filter.preprocessing import DEGRADED_NS, ImuIntake, Interval
from vio.filter.relocalization import LostWatch, relocation
from vio.records import ImuNoise, ImuSample, Moment, NavState

_JUDGE_NS = 200_000_000  # how often the calibration is judged
_SLOTS = 256  # measurements that the window remembers
_START_NS = 1_500_000_000  # how far back the start looks
_AGAIN_NS = 10_000_000_000  # a reset so soon after a start or a reset: what it kept was wrong
VERDICTS = {
    kinds.PENDING: "waiting",
    kinds.ACCEPTED: "fused",
    kinds.POSITION_ONLY: "fused_position",
    kinds.ROTATION_ONLY: "fused_rotation",
    kinds.REJECTED: "gated",
    kinds.SINGULAR: "singular",
}

TAKEN = ("fused",)  # a half alone counts as neither taken nor refused
REFUSED = ("gated", "singular", "too_old", "too_early", "duplicate")


class ErrorStateFilter:
    """Error-state Kalman filter with a fixed lag; `imu`, `pose`, `corners` feed it.

    Late and shuffled measurements give the history of ordered ones; no clock is read.
    Source: Sola, 1711.02508.
    """

    def __init__(
        self,
        config: VioConfig,
        camera: Camera,
        noise: ImuNoise,
        tag_map: TagMap | None = None,
        floor: IntrinsicsErrorConfig | None = None,
    ) -> None:
        R_IC, p_IC = geo.invert(camera.R_CI, camera.p_CI)
        self._config, self._map = config, tag_map
        self._centre_px, self._floor = camera.intrinsics[2:], floor or IntrinsicsErrorConfig()
        self._rig = Rig(R_IC, p_IC, camera.timeshift_s)
        known = tag_map.gravity if tag_map is not None else None
        self._gravity = (
            None if known is None else (np.array(known.dir), float(np.radians(known.sigma_deg)))
        )
        rate = noise.rate_hz or 200.0
        ticks = int(np.ceil((config.buffer_s + 0.5) * max(rate, 100.0) * 1.5))
        tags = config.max_tags if config.update == "corners" else 0
        width = kinds.HEAD + max(pose.NUMBERS, constraints.NUMBERS, tags * corners.NUMBERS)
        self._history = History((ticks, _SLOTS, width), model_of(noise, config))
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
        self._check = self._new_check()

    def _new_check(self) -> CalibrationCheck:
        return CalibrationCheck(self._config, self._rig.R_IC, self._rig.time_offset_s)

    def imu(self, sample: ImuSample) -> NavState | None:
        """Take an IMU sample; the state valid at its stamp, None before the start."""
        intervals, lost = self._intake.take(sample)
        if lost:
            self._restart("imu_lost")
        for step in intervals:
            self._take(step)
        if not intervals or not self._started:
            return None
        return self.nav(sample.arrival_ns)

    def _take(self, step: Interval) -> None:
        self._intervals.append(step)
        while self._intervals[-1].t_ns - self._intervals[0].t_ns > _START_NS:
            self._intervals.popleft()
        if not self._started:
            self._try_start()
            return
        waiting = self._history.waits
        self._history.add_interval(step.t_ns, step.gyro, step.accel, step.scale)
        if self._on_ground and step.t_ns - self._still_ns > self._config.still_every_s * 1e9:
            self._stand_still(step.t_ns)
        if step.t_ns - self._judged_ns > _JUDGE_NS:
            self._judge_calibration(step.t_ns)
        if waiting:
            self._review()

    def _judge_calibration(self, t_ns: int) -> None:
        """Ask the judge, about a state that nothing late can change: order leaves no trace."""
        self._judged_ns, history = t_ns, self._history
        tick = history.at_or_before(t_ns - round(self._config.buffer_s * 1e9))
        if tick < 0:
            return
        x, P = history.snapshots.x[tick], history.snapshots.P[tick]
        stamp_ns = t_ns - round(x[at.X_TD] * 1e9)
        for row in self._check.rows(x, P):
            self._counters["rig_doubted" if row[0] == kinds.OPEN else "rig_confirmed"] += 1
            self._insert(stamp_ns, row)

    def pose(self, measured: PoseMeasurement) -> None:
        """Take a camera pose, however late; its stamp is the camera's."""
        if self._remember(measured):
            self._insert(measured.t_ns, pose.pack(measured))
            self._review()

    def corners(self, t_ns: int, seen: Observations, measured: PoseMeasurement | None) -> None:
        """Take the tags of one frame; the pose of the same frame serves start and recovery."""
        if self._map is None:
            raise ValueError("the corner update needs the tag map")
        if measured is not None:
            self._remember(measured)
        if not self._started:
            return
        row = corners.pack(seen, self._map, self._centre_px, self._floor, self._config.max_tags)
        if row is not None:
            self._insert(t_ns, row)
            self._review()

    def ground(self, on_ground: bool) -> None:
        """Say whether the vehicle stands on the ground (disarmed or landed): then it is still."""
        self._on_ground = on_ground

    def nav(self, known_ns: int | None = None) -> NavState | None:
        """The state valid at the newest IMU sample, None before the start; known_ns: for it."""
        if not self._started:
            return None
        return nav_state(self._history.now_ns, self._history.x, self._history.P, known_ns)

    def moment(self, t_ns: int | None = None) -> Moment | None:
        """The filter at a stamp of the camera's clock, None: at its newest sample, for a vehicle.

        None before the start, for a stamp beyond its memory, and 50 ms ahead of the IMU.
        """
        return moment(self._history, t_ns) if self._started else None

    def prior(self, t_ns: int) -> PosePrior | None:
        """Where the camera is at a stamp of its clock, with the prediction's covariance."""
        if not self._started:
            return None
        return camera_prior(self._history, t_ns)

    def state(self) -> Array | None:
        """The whole nominal state now (see `state`), None before the start."""
        return self._history.x.copy() if self._started else None

    def covariance(self) -> Array | None:
        """The whole error covariance now (n, n), None before the start."""
        return self._history.P.copy() if self._started else None

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
        out.update({VERDICTS[k]: v for k, v in self._history.verdicts().items() if v})
        return dict(sorted(out.items()))

    def health(self) -> Health:
        """State with reasons, judged at the newest IMU sample."""
        if not self._started:
            config = self._config.health
            return judge(None, self._resets, self._waiting, config, self._distrust)
        now_ns, variances = self._history.now_ns, self._history.P.diagonal()
        sigma_m = float(np.sqrt(variances[at.P : at.P + 3].max()))
        sigma_deg = float(np.degrees(np.sqrt(variances[at.TH : at.TH + 3].max())))
        degraded = self._intake.degraded_at_ns
        recent = degraded is not None and now_ns - degraded < 10 * DEGRADED_NS
        age = max(0.0, (now_ns - self._accepted_ns) * 1e-9)
        late_s = max(0.0, self._ahead_ns(self._newest_ns) * 1e-9)
        far = self._bounds.calibration_far(self._history.x)
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
        if measured.t_ns not in [p.t_ns for p in self._poses]:
            self._poses.append(measured)
        elif not self._started:
            self._counters["duplicate"] += 1
            return False
        if not self._started or self._ahead_ns(measured.t_ns) <= self._config.buffer_s * 1e9:
            self._newest_ns = measured.t_ns  # of the latest to come: a stamp from the future passes
        if self._started:
            return True
        self._try_start()
        return False

    def _ahead_ns(self, t_ns: int) -> int:
        """How far a stamp of the camera's clock is ahead of the newest IMU sample."""
        return t_ns + self._history.time_offset_ns - self._history.now_ns

    def _insert(self, t_ns: int, row: Array) -> None:
        ahead, limit = self._ahead_ns(t_ns), self._config.buffer_s * 1e9
        why = "too_old" if ahead < -limit else "too_early" if ahead > limit else ""
        why = why or self._history.insert(t_ns, row)
        if why:
            self._counters[why] += 1

    def _stand_still(self, t_ns: int) -> None:
        self._still_ns = t_ns
        recent = [p for p in self._poses if p.t_ns > self._newest_ns - _START_NS]
        if moves(recent):  # on a lift, a boat, in a hand that is very calm
            self._counters["still_vetoed"] += 1
            return
        stamp = t_ns - self._history.time_offset_ns
        self._insert(stamp, constraints.still(self._config.still_sigma_m_s))

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
        self._history.start(found.t_ns, found.x, found.P, anew)
        for s in steps:
            if s.t_ns > found.t_ns:
                self._history.add_interval(s.t_ns, s.gyro, s.accel, s.scale)
        self._counters["start_tilted"] += int(found.tilt_rad > 0.0)
        self._resets += self._started_once
        self._check = self._new_check()
        self._started = self._started_once = True
        self._accepted_ns = self._still_ns = self._judged_ns = found.t_ns
        self._begun_ns = self._turned_ns = found.t_ns
        self._lost.clear()
        for one in sorted(self._poses, key=lambda p: p.t_ns):
            if one.t_ns >= poses[0].t_ns:
                self._insert(one.t_ns, pose.pack(one))
        self._review()

    def _restart(self, why: str) -> None:
        self._started = False
        self._intervals.clear()
        self._poses.clear()
        self._waiting = (why,)
        self._counters["restarts"] += 1

    def _review(self) -> None:
        """After measurements were decided: what health needs, and whether to recover."""
        seen, now_ns = self._history.judged(), self._history.now_ns
        good = seen.last(kinds.ACCEPTED, kinds.POSITION_ONLY)
        bad = seen.stamp_ns[good + 1 :]
        self._update_signs(seen, len(bad))
        believed_ns = int(seen.due_ns[good]) if good >= 0 else self._accepted_ns
        c, age_s = self._config.recovery, (now_ns - believed_ns) * 1e-9
        if not self._distrust and self._lost.asks(self.health(), now_ns, self._newest_ns):
            self._counters["lost_restarts"] += 1
            self._begin_again(list(self._poses)[-len(bad) :] if bad.size else list(self._poses))
        elif len(bad) >= c.rejects and age_s > c.after_s:
            self._recover(bad[-c.rejects :])
        else:
            self._review_rotations(seen)

    def _update_signs(self, seen: Judged, rejects: int) -> None:
        """What health is judged by: when a pose was taken, rejects in a row, innovations."""
        whole, after_ns = seen.last(kinds.ACCEPTED), self._config.recovery.turned_after_s * 1e9
        if whole >= 0:
            self._turned_ns = int(seen.due_ns[whole])
        taken = seen.with_verdict(kinds.ACCEPTED, kinds.POSITION_ONLY)
        lately = np.flatnonzero(taken & (seen.due_ns - self._turned_ns < after_ns))
        if lately.size:  # a position alone counts while a whole pose stands behind it
            self._accepted_ns = int(seen.due_ns[lately[-1]])
        self._rejects = rejects
        nis = seen.nis[-20:]
        self._nis = median(nis.tolist()) / 6.0 if nis.size else 0.0
        self._newest_nis = float(nis[-1]) / 6.0 if nis.size else np.nan

    def _review_rotations(self, seen: Judged) -> None:
        """Recover where positions pass and rotations do not, pose after unambiguous pose."""
        c = self._config.recovery
        later = seen.stamp_ns[seen.last(kinds.ACCEPTED, kinds.ROTATION_ONLY) + 1 :]
        if len(later) < c.turned:
            return
        clear = {p.t_ns for p in self._poses if "ambiguous" not in p.flags}
        turned = [t for t in later.tolist() if t in clear]
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
        soon = self._history.now_ns - self._begun_ns < _AGAIN_NS
        if soon or self._bounds.implausible(self._history.x):
            self._begin_again(poses)
            return
        move = relocation(self._history, poses, self._config.recovery)
        if move is None:
            self._counters["recovery_refused"] += 1
            return
        self._resume(*move, poses[-1].t_ns)

    def _resume(self, tick: int, x: Array, P: Array, stamp_ns: int) -> None:
        """Begin anew at a snapshot with another state, and integrate up to now."""
        history = self._history
        t0_ns, later = int(history.snapshots.t[tick]), history.intervals_after(tick)
        history.start(t0_ns, x, P)
        for t_ns, imu in later:
            history.add_interval(t_ns, imu[0:3], imu[3:6], imu[6:12])
        self._resets += 1
        self._rejects = 0
        self._accepted_ns = self._turned_ns = stamp_ns
        self._begun_ns = history.now_ns
        self._lost.clear()
        self._counters["resets"] += 1

    def _begin_again(self, poses: list[PoseMeasurement]) -> None:
        """Forget state and priors, start from these poses: what has failed twice is not kept."""
        self._started, self._waiting = False, ("begins_again",)
        self._counters["restarts"] += 1
        self._rejects = 0
        self._poses = deque(poses, maxlen=self._poses.maxlen)
        self._try_start()
