"""Shows a flight as it happens: a Foxglove WebSocket server, an MCAP file, or both.

The flight only puts things down; a thread of this module's turns them into messages. What it does
not get to in time is dropped and counted, so a slow viewer (or disk) never slows the flight.
"""

import contextlib
import logging
import threading
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tagvo.camera.model import Camera
from tagvo.config import JointConfig
from tagvo.geometry import Array, BoolArray
from tagvo.pipeline import Trace
from tagvo.records import Frame, Observations
from tagvo.tags.tag_map import TagMap
from vio.config.daemon import ORIGINS
from vio.errors import VioError
from vio.filter.eskf import ErrorStateFilter
from vio.filter.health import Health
from vio.records import NavState
from vio.sinks.origins import OriginProxy, hidden_host

LOG = logging.getLogger("vio.sinks.live")
_FRAME_NS, _STATE_NS, _AGAIN_NS = 200_000_000, 50_000_000, 5_000_000_000
_SCENE_NS = 200_000_000
_FRAMES, _STATES, _WORDS = 3, 100, 200  # that may wait
_TRAIL, _TRAIL_M = 400, 0.03
_WAKE_S = 0.05  # the thread looks by itself: to wake it at every sample would cost the flight
_PATIENCE_S, _GOODBYE_S = 2.0, 0.3
_LEVELS = ((logging.ERROR, "Error"), (logging.WARNING, "Warning"), (logging.INFO, "Info"))


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """A frame with what was found in it."""

    t_ns: int
    image: Any
    seen: Observations
    rejected: BoolArray
    where: tuple[Array, Array] | None  # R_WC, p_WC that the filter expects
    health: Health | None
    figures: dict[str, float]


class LiveView:
    """A sink of a run; `look` takes each frame's intermediates. `close` ends the server and file.

    counters: what was shown and what was dropped.
    """

    def __init__(
        self,
        tag_map: TagMap,
        camera: Camera,
        *,
        port: int | None = None,
        host: str = "127.0.0.1",
        mcap: Path | None = None,
        beliefs: ErrorStateFilter | None = None,
        reject_weight: float = JointConfig().reject_weight,
        lossless: bool = False,
        epoch_ns: int = 0,
        origins: Sequence[str] = ORIGINS,
    ) -> None:
        """port: of the server, 0: any free one, None: no server; mcap: a file not there yet.

        beliefs: the filter, asked for its prior and health; reject_weight: below it the
        joint pose has rejected a tag (tagvo.joint.reject_weight); lossless: let a run wait for
        the file rather than drop; epoch_ns: added to stamps to make them times of day; origins: of
        the pages that may look (`vio.sinks.origins`). VioError
        where the port is in use, the file is there or foxglove-sdk is not installed.
        """
        self._map, self._camera, self._filter = tag_map, camera, beliefs
        self._epoch_ns, self._lossless, self._reject = epoch_ns, lossless, reject_weight
        self.counters: Counter[str] = Counter()
        self._open(port, host, mcap, origins)
        self._channels = _Channels(self._context)
        self._frames: deque[_Seen] = deque()
        self._states: deque[NavState] = deque()
        self._words: deque[tuple[int, str, str]] = deque(maxlen=_WORDS)
        self._more = threading.Condition()
        self._image: Frame | None = None
        self._frame_ns = self._state_ns = self._map_ns = self._scene_ns = -(1 << 62)
        self._now_ns = 0
        self._trail: deque[Array] = deque(maxlen=_TRAIL)
        self._ending = False
        self._handler = _Words(self)
        logging.getLogger("vio").addHandler(self._handler)
        self._thread = threading.Thread(target=self._work, name="live view", daemon=True)
        self._thread.start()

    def _open(self, port: int | None, host: str, mcap: Path | None, origins: Sequence[str]) -> None:
        """Context, file, server and door; what was opened is closed where the next one fails."""
        try:
            import foxglove
        except ImportError:
            raise VioError("the live view needs foxglove-sdk: pip install 'tagvio[live]'") from None
        self._context = foxglove.Context()
        self._server = self._file = None
        self._door: OriginProxy | None = None
        try:
            if mcap is not None:
                mcap.parent.mkdir(parents=True, exist_ok=True)
                self._file = foxglove.open_mcap(str(mcap), context=self._context)
            if port is not None:
                inner = hidden_host()
                self._server = foxglove.start_server(
                    name="tagvio", host=inner, port=0, context=self._context,
                    message_backlog_size=64,
                )  # fmt: skip
                self._door = OriginProxy(host, port, (inner, int(self._server.port)), origins)
                self.counters = self._door.counters
        except (VioError, OSError, RuntimeError, ValueError) as err:
            what = f"{mcap}" if mcap is not None and self._file is None else f"{host}:{port}"
            if self._server is not None:
                self._server.stop()
            if self._file is not None:
                self._file.close()
            if isinstance(err, VioError):
                raise
            raise VioError(f"live view {what}: {' '.join(str(err).split())}") from None

    @property
    def port(self) -> int | None:
        """Where the server listens; None: there is none."""
        return None if self._door is None else self._door.port

    # what the flight puts down

    def event(self, event: object) -> None:
        """An event is about to be taken: a frame's image is kept for when its tags are known."""
        if isinstance(event, Frame):
            self._image = event

    def output(self, name: str, output: NavState) -> None:
        """Something new of an estimator: the filter's is shown, up to 20 a second."""
        if name != "vio" or 0 <= output.t_ns - self._state_ns < _STATE_NS:
            return
        self._state_ns = output.t_ns
        self._put(self._states, output, _STATES, "states")

    def look(self, trace: Trace) -> None:
        """A frame with its intermediates, up to five a second."""
        self._now_ns = trace.t_ns
        if not self._lossless and 0 <= trace.t_ns - self._frame_ns < _FRAME_NS:
            return
        self._frame_ns = trace.t_ns
        rejected = trace.rejected(self._reject)
        prior = None if self._filter is None else self._filter.prior(trace.t_ns)
        where = None if prior is None else (prior.R_WC, prior.p_WC)
        health = None if self._filter is None else self._filter.health()
        mine = self._image is not None and self._image.t_ns == trace.t_ns
        image = self._image.image if mine and self._image is not None else None
        figures = self._figures(trace)
        item = _Seen(trace.t_ns, image, trace.observations, rejected, where, health, figures)
        self._put(self._frames, item, _FRAMES, "frames")

    def _figures(self, trace: Trace) -> dict[str, float]:
        """Numbers of a frame for the plots."""
        used = 0 if trace.pose is None else len(trace.pose.tag_ids)
        out = {"tags_seen": float(len(trace.observations)), "tags_used": float(used)}
        if self._filter is not None:
            out["nis_per_dof"] = self._filter.nis
            state = self._filter.state()
            if state is not None:
                from vio.filter import state as at

                for k, axis in enumerate("xyz"):
                    out[f"gyro_bias_{axis}_rad_s"] = float(state[at.X_BG + k])
                    out[f"accel_bias_{axis}_m_s2"] = float(state[at.X_BA + k])
                out["time_offset_ms"] = 1e3 * float(state[at.X_TD])
        return {name: value for name, value in out.items() if np.isfinite(value)}

    def say(self, level: str, text: str) -> None:
        """A log message."""
        with self._more:
            self._words.append((self._now_ns, level, text))

    def _put(self, waiting: "deque[Any]", item: Any, limit: int, what: str) -> None:
        """Leave something for the thread; the oldest goes where too much waits."""
        with self._more:
            if self._lossless:
                self._more.wait_for(lambda: len(waiting) < limit, _PATIENCE_S)
            if len(waiting) >= limit:
                waiting.popleft()
                self.counters[f"live_{what}_dropped"] += 1
            waiting.append(item)
            if self._lossless:
                self._more.notify_all()

    # what the thread does

    def _work(self) -> None:
        while True:
            with self._more:
                if not (self._ending or (self._lossless and self._something())):
                    self._more.wait(_WAKE_S)
                frames, states = list(self._frames), list(self._states)
                words = list(self._words)
                self._frames.clear()
                self._states.clear()
                self._words.clear()
                done = self._ending and not (frames or states or words)
                self._more.notify_all()
            if done:
                return
            try:
                self._show(frames, states, words)
            except Exception:  # a view must not end for one strange frame, nor be silent
                self.counters["live_faults"] += 1
                if self.counters["live_faults"] == 1:
                    LOG.exception("the live view goes on after a fault")

    def _something(self) -> bool:
        return bool(self._frames or self._states or self._words)

    def _show(
        self, frames: list[_Seen], states: list[NavState], words: list[tuple[int, str, str]]
    ) -> None:
        for t_ns, level, text in words:
            self._channels.log(t_ns + self._epoch_ns, level, text)
        for frame in frames:
            self._show_frame(frame)
        for state in states:
            self._show_state(state)

    def _show_frame(self, frame: _Seen) -> None:
        from vio.sinks import live_messages as make

        c, t_ns = self._channels, frame.t_ns + self._epoch_ns
        self.counters["live_frames"] += 1
        if not 0 <= t_ns - self._map_ns < _AGAIN_NS:  # again for those who came later
            self._map_ns = t_ns
            c.scene.log(make.map_scene(t_ns, self._map), log_time=t_ns)
            c.calibration.log(make.calibration(t_ns, self._camera), log_time=t_ns)
        if frame.image is not None and c.image.has_sinks():
            c.image.log(make.image(t_ns, frame.image), log_time=t_ns)
        if c.outlines.has_sinks():
            predicted = [] if frame.where is None else make.expected(
                self._map, self._camera, *frame.where)  # fmt: skip
            width = self._camera.resolution[0]
            shown = make.outlines(t_ns, frame.seen, frame.rejected, predicted, width)
            c.outlines.log(shown, log_time=t_ns)
        if frame.health is not None:
            h = frame.health
            word = {"state": h.state.value, "reasons": list(h.reasons), "resets": h.resets}
            c.health.log(word, log_time=t_ns)
        c.figures.log(dict(frame.figures), log_time=t_ns)

    def _show_state(self, state: NavState) -> None:
        from vio.sinks import live_messages as make

        c, t_ns = self._channels, state.t_ns + self._epoch_ns
        body = make.Body(t_ns, state.p_WI, state.R_WI, state.v_WI, state.cov)
        if not self._trail or np.linalg.norm(state.p_WI - self._trail[-1]) > _TRAIL_M:
            self._trail.append(state.p_WI.copy())
        if not 0 <= t_ns - self._scene_ns < _SCENE_NS and c.scene.has_sinks():
            self._scene_ns = t_ns
            c.scene.log(make.body_scene(body, np.array(self._trail)), log_time=t_ns)
        c.transforms.log(make.transforms(body, self._camera), log_time=t_ns)
        c.state.log(_numbers(state), log_time=t_ns)
        self.counters["live_states"] += 1

    def close(self) -> None:
        """Show what waits, for two seconds at most, and end."""
        logging.getLogger("vio").removeHandler(self._handler)
        with self._more:
            self._ending = True
            self._more.notify_all()
        self._thread.join(_PATIENCE_S)
        if self._door is not None:
            self._door.close()
        if self._server is not None:  # it waits for clients, and one that has stalled never goes
            stopper = threading.Thread(target=self._server.stop, name="live end", daemon=True)
            stopper.start()
            stopper.join(_GOODBYE_S)
        if self._file is not None:
            self._file.close()


class _Words(logging.Handler):
    """Hands log messages of ours to a view."""

    def __init__(self, view: LiveView) -> None:
        super().__init__(logging.INFO)
        self._view = view

    def emit(self, record: logging.LogRecord) -> None:
        level = next((name for least, name in _LEVELS if record.levelno >= least), "Debug")
        with contextlib.suppress(Exception):  # a message that cannot be formatted is not our fault
            self._view.say(level, record.getMessage())


class _Channels:
    """The topics of one view."""

    def __init__(self, context: Any) -> None:
        from foxglove import Channel, channels

        self.image = channels.CompressedImageChannel("/camera/image", context=context)
        self.calibration = channels.CameraCalibrationChannel("/camera/calibration", context=context)
        self.outlines = channels.ImageAnnotationsChannel("/camera/tags", context=context)
        self.scene = channels.SceneUpdateChannel("/scene", context=context)
        self.transforms = channels.FrameTransformsChannel("/tf", context=context)
        self._words = channels.LogChannel("/log", context=context)
        self.state = Channel("/filter/state", message_encoding="json", context=context)
        self.figures = Channel("/filter/figures", message_encoding="json", context=context)
        self.health = Channel("/filter/health", message_encoding="json", context=context)

    def log(self, t_ns: int, level: str, text: str) -> None:
        """A message of ours."""
        from foxglove import messages as fox

        from vio.sinks.live_messages import stamp

        kind = getattr(fox.LogLevel, level)
        word = fox.Log(timestamp=stamp(t_ns), level=kind, message=text, name="tagvio")
        self._words.log(word, log_time=t_ns)


def _numbers(state: NavState) -> dict[str, Any]:
    """A state as numbers to plot: metres, degrees."""
    from tagvo import geometry as geo

    rpy = np.degrees(geo.rpy_from_matrix(state.R_WI))
    out: dict[str, Any] = {
        "position_m": dict(zip("xyz", map(float, state.p_WI), strict=True)),
        "rpy_deg": dict(zip(("roll", "pitch", "yaw"), map(float, rpy), strict=True)),
        "age_ms": 1e-6 * ((state.known_ns or state.t_ns) - state.t_ns),
    }
    if state.v_WI is not None:
        out["velocity_m_s"] = dict(zip("xyz", map(float, state.v_WI), strict=True))
    if state.cov is not None:
        sigma = np.sqrt(np.maximum(np.diag(state.cov), 0.0))
        out["sigma_m"] = dict(zip("xyz", map(float, sigma[:3]), strict=True))
        out["sigma_deg"] = dict(zip("xyz", map(float, np.degrees(sigma[3:6])), strict=True))
    return out
