"""Gathers what the set-up check needs while a flight runs, and asks it now and then."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tagvo import geometry as geo
from tagvo.camera.model import Camera
from tagvo.geometry import Array
from tagvo.pipeline import Trace
from tagvo.records import PoseMeasurement
from tagvo.tags.tag_map import TagMap
from vio.records import ImuSample
from vio.setup_check.findings import Finding
from vio.setup_check.hypotheses import StatedRig, Turns, check_force, check_setup, enough, moving
from vio.setup_check.metric_scale import Path, check_scale

_PAIR_NS, _LONGEST_NS = 180_000_000, 450_000_000  # between two frames: VO's noise against turning
_SPAN_NS = 20_000_000_000  # that is looked at, once it turns enough
_LEAST_TAGS = 2  # one alone may lie in its other planar solution, for as long as it is looked at
_EVERY = 20  # pairs between two looks
_MOST_PAIRS = 170  # half a minute
_MOST_LOOKS = 45  # three minutes: who has not moved enough by then for a scale hovers
_GAP_NS = 80_000_000  # frames for the tags' sizes
_RATIOS = 60
_SCALE_NAMED, _SCALE_CERTAIN = np.log(1.15), np.log(1.2)  # smallest family: 1.25 total per border
_RATE, _FORCE = 35.0, 160.0  # samples beyond are faults of another kind


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A turn of C from a_ns to b_ns: phi_C (3,), sigma per axis [rad]; R_WC (3, 3) at a_ns.

    p_WC (2, 3): where C was at both.
    """

    a_ns: int
    b_ns: int
    phi_C: Array
    sigma: float
    R_WC: Array
    p_WC: Array


_Sample = tuple[int, Array, Array]  # stamp, gyro, accel


def _path(samples: list[_Sample], pairs: list[_Pair]) -> Path:
    """The check's input, times from the first sample on."""
    zero = samples[0][0]
    pairs = [p for p in pairs if p.b_ns > zero]
    phi = np.array([p.phi_C for p in pairs]).reshape(-1, 3)
    keep = np.flatnonzero(moving(phi))
    pick = [pairs[int(k)] for k in keep]
    turns = Turns(
        np.array([p.a_ns - zero for p in pick]) * 1e-9,
        np.array([p.b_ns - zero for p in pick]) * 1e-9,
        phi[keep],
        np.array([p.sigma for p in pick]),
        np.array([p.R_WC for p in pick]).reshape(-1, 3, 3),
        np.array([t - zero for t, _, _ in samples]) * 1e-9,
        np.array([w for _, w, _ in samples]),
        np.array([f for _, _, f in samples]),
    )
    return Path(turns, np.array([p.p_WC for p in pick]).reshape(-1, 2, 3))


class SetupWatch:
    """Takes samples and frames in order of arrival; `findings` is what it knows by now.

    It has its final word 20 s after the first turn once there was enough turning, and then keeps
    nothing. `changed` is called with the findings whenever they change.
    """

    def __init__(
        self,
        camera: Camera,
        tag_map: TagMap,
        *,
        with_imu: bool = True,
        changed: Callable[[list[Finding]], None] = lambda findings: None,
        later: Callable[[Callable[[], None]], None] = lambda job: job(),
    ) -> None:
        """with_imu false: only what needs none (the tags' sizes).

        later: what runs a judgement; the default at once, a flight beside its loop.
        """
        gravity = tag_map.gravity
        up_W = None if gravity is None else -np.array(gravity.dir, dtype=float)
        self._rig = StatedRig(camera.R_CI, camera.timeshift_s, up_W)
        self._map = tag_map
        self._imu: deque[_Sample] = deque()
        self._pairs: deque[_Pair] = deque(maxlen=_MOST_PAIRS)
        self._before: PoseMeasurement | None = None
        self._new = 0
        self._sized_ns: int | None = None
        self._ratios: list[float] = []
        self._changed, self._later = changed, later
        self._done, self._sized = not with_imu, False
        self._turned: list[Finding] = []
        self._scaled: list[Finding] = []
        self._metric: list[Finding] = []
        self._told: list[str] = []
        self._looks, self._turns_known = 0, False
        self._p_CI = camera.p_CI
        self.stated: list[Finding] = []

    def settle(self) -> None:
        """The log has ended: a last look at what there is."""
        self._judge(list(self._imu), list(self._pairs))

    @property
    def findings(self) -> list[Finding]:
        """All that is known to be wrong, the surest first."""
        every = [*self.stated, *self._turned, *self._scaled]
        known = {f.code for f in every}
        every += [f for f in self._metric if f.code not in known]
        return sorted(every, key=lambda f: not f.certain)

    @property
    def certain(self) -> bool:
        """Whether a mistake is beyond doubt."""
        return any(f.certain for f in self.findings)

    def event(self, event: object) -> None:
        """Take an IMU sample; other events come as traces."""
        if self._done:
            self._imu.clear()
            return
        if not isinstance(event, ImuSample):
            return
        if self._imu and event.t_ns <= self._imu[-1][0]:
            return
        if np.abs(event.gyro_I).max() < _RATE and np.abs(event.accel_I).max() < _FORCE:
            self._imu.append((event.t_ns, event.gyro_I, event.accel_I))
            while event.t_ns - self._imu[0][0] > 2 * _SPAN_NS:
                self._imu.popleft()

    def output(self, name: str, output: object) -> None:
        """What estimators say has no part in it."""

    def look(self, trace: Trace) -> None:
        """Take a frame's tags and pose."""
        if not self._sized:
            self._size(trace)
        if self._done:
            self._pairs.clear()
            return
        if trace.pose is None or "ambiguous" in trace.pose.flags:
            return
        if len(trace.pose.tag_ids) < _LEAST_TAGS:
            return
        pose, before = trace.pose, self._before
        if before is not None and 0 < pose.t_ns - before.t_ns < _PAIR_NS:
            return
        self._before = pose
        if before is None or not 0 < pose.t_ns - before.t_ns < _LONGEST_NS:
            return
        phi = geo.log(before.R_WC.T @ pose.R_WC)
        sigma = float(np.sqrt(np.trace(before.cov[3:, 3:] + pose.cov[3:, 3:]) / 3.0))
        places = np.stack([before.p_WC, pose.p_WC])
        self._pairs.append(
            _Pair(before.t_ns, pose.t_ns, phi, max(sigma, 1e-4), before.R_WC, places)
        )
        self._new += 1
        if self._new >= _EVERY:
            self._new = 0
            samples, pairs = list(self._imu), list(self._pairs)
            self._later(lambda: self._judge(samples, pairs))

    def _judge(self, samples: list[_Sample], pairs: list[_Pair]) -> None:
        """Look at all there is now: the turns until they are known, then the scale as well."""
        if self._done or len(samples) < 50 or len(pairs) < _EVERY:
            return
        path = _path(samples, pairs)
        turns = path.turns
        self._looks += 1
        if not self._turns_known:
            lacks = check_force(turns.accel)
            self._turned = [lacks] if lacks is not None else check_setup(turns, self._rig)
            span = pairs[-1].b_ns - pairs[0].a_ns
            self._turns_known = any(f.certain for f in self._turned) or (
                span > _SPAN_NS and len(turns.a_s) >= 60 and enough(turns, self._rig)
            )
        told = bool(self._turned)  # what the scale is judged by is wrong
        if not told:
            self._metric, told = check_scale(path, self._rig, self._p_CI)
        self._done = self._turns_known and (told or self._looks > _MOST_LOOKS)
        self._tell()

    def _tell(self) -> None:
        """Pass the findings on where they are others than those told last."""
        codes: list[str] = [f.code for f in self.findings]
        if codes != self._told:
            self._told = codes
            self._changed(self.findings)

    def _size(self, trace: Trace) -> None:
        """Tags' distances as each tag's own size measures them, against the map's."""
        poses, obs = trace.tag_poses, trace.observations
        late = self._sized_ns is not None and 0 <= trace.t_ns - self._sized_ns < _GAP_NS
        if poses is None or len(obs) < 2 or late:
            return
        self._sized_ns = trace.t_ns
        ratio = pitch_ratio(poses.p_CT[:, 0], self._map.p_WT[obs.row], self._map.size[obs.row])
        if ratio is None:
            return
        self._ratios.append(ratio)
        if len(self._ratios) % _EVERY == 0:
            self._scaled = check_sizes(np.array(self._ratios), self._map)
            self._sized = len(self._ratios) >= _RATIOS
            self._tell()


def pitch_ratio(p_CT: Array, p_WT: Array, size: Array) -> float | None:
    """Median of map distance over seen distance of tags (n, 3) that lie apart; None: none do."""
    ratios = []
    for i, j in list(combinations(range(min(len(size), 12)), 2)):
        apart = float(np.linalg.norm(p_WT[i] - p_WT[j]))
        seen = float(np.linalg.norm(p_CT[i] - p_CT[j]))
        if apart > 1.2 * max(size[i], size[j]) and seen > 0.0:
            ratios.append(apart / seen)
    return float(np.median(ratios)) if ratios else None


def check_sizes(ratios: Array, tag_map: TagMap) -> list[Finding]:
    """Whether two halves of the frames agree that the tags are of another size than the map says.

    ratios (m,) as of `pitch_ratio`: 1 where the map is right, the family's total over border where
    `size_kind` total was meant and border said, and one over it the other way.
    """
    half = len(ratios) // 2
    logs = np.log(ratios)
    parts = [float(np.median(part)) for part in (logs[:half], logs[half:])]
    whole = float(np.median(logs))
    if min(abs(p) for p in parts) < _SCALE_NAMED or abs(parts[0] - parts[1]) > 0.1:
        return []
    family = float(np.log(tag_map.family.total_per_border(tag_map.border_bits)))
    other = "total" if tag_map.size_kind == "border" else "border"
    meant = f" (size_kind: {other}?)" if abs(abs(whole) - family) < 0.1 else ""
    text = (
        f"tags lie {np.exp(whole):.2f} times as far apart as their size in the map lets them"
        f" be: the sizes are wrong by that factor, size_kind is {tag_map.size_kind}{meant}"
    )
    return [Finding("size_kind", text, float(np.exp(whole)), bool(abs(whole) > _SCALE_CERTAIN))]
