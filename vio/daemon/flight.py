"""One flight: threads at the edges, the one loop between them, and an orderly end."""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tagvo.pipeline import TagVO, Trace
from tagvo.records import Frame, PosePrior
from vio.daemon.detection_threads import Detection
from vio.daemon.latency_meter import Meter
from vio.daemon.preflight import Parts
from vio.daemon.publisher import Publisher
from vio.daemon.recorder import Recorder
from vio.daemon.setup_guard import SetupGuard
from vio.daemon.status import Rates, Status, cpu_by_thread
from vio.daemon.systemd import Systemd
from vio.daemon.time_base import FlightClock
from vio.localize.baselines import VoOnly
from vio.localize.run import RunResult, Sink, run
from vio.localize.stopwatch import Stopwatch
from vio.mavlink.bridge import Bridge
from vio.mavlink.latency import Ages
from vio.setup_check.watch import SetupWatch
from vio.sinks.live_view import LiveView
from vio.sources.live.events import LiveEvents
from vio.sources.live.live_camera import Latest

LOG = logging.getLogger("vio.daemon")
_KEEP = 900
Counters = list[Counter[str]]


class Flight:
    """The parts of a flight, put together; `fly` runs it until `stop`, `end` puts all away.

    events and latest are where sources put what comes; clock maps a log's time to now.
    """

    def __init__(
        self,
        parts: Parts,
        bridge: Bridge,
        stop: Callable[[], bool],
        recorder: Recorder | None,
        clock: FlightClock,
        counters: "Counters",
    ) -> None:
        """counters: further ones for the status, which may grow until the flight begins."""
        self.bridge, self.recorder, self.clock, self.meter = bridge, recorder, clock, Meter()
        self.events = LiveEvents(stop, lambda: clock.to_log(time.monotonic_ns()))
        self.latest = Latest()
        config = parts.config
        self._watch = Stopwatch(_KEEP)
        note = recorder.health if recorder is not None else lambda t_ns, health: None
        self.setup = SetupGuard(bridge.alarm, bridge.say, lambda: bridge.companion.vehicle.armed)
        self._setup_watch = SetupWatch(
            parts.camera, parts.tag_map, changed=self.setup.found, later=self.setup.later
        )
        self.localizer = Publisher(
            parts, bridge, clock, note=note, blame=self.setup.blame, lap=self._watch.lap
        )
        self._vo, self._tag_map = VoOnly(parts.camera), parts.tag_map
        tracks = config.tagvo.track.mode == "on"
        foresee = self.localizer.foresee if tracks else _nowhere
        vos = [
            TagVO(parts.camera, parts.tag_map, config.tagvo)
            for _ in range(config.daemon.detection_threads)
        ]
        self.detection = Detection(self.latest, vos, self.events.put, foresee)
        self._stop, self._more = stop, counters
        self._noise_said = False
        self.result = RunResult(keep=False)
        bridge.watch(self.meter.sent)
        if recorder is not None:
            bridge.watch(recorder.sent)
        self.view: LiveView | None = None

    def ready(self) -> None:
        """Start what stands between the sources and the loop."""
        if self.recorder is not None:
            self.recorder.start()
        self.detection.start()

    def fly(self) -> RunResult:
        """The loop, until the events end or stop says so."""
        sinks: list[Sink] = [s for s in (self.recorder, self.view) if s is not None]
        sinks.append(self._setup_watch)

        def look(trace: Trace) -> None:
            self._setup_watch.look(trace)
            if self.view is not None:
                self.view.look(trace)

        return run(
            self.events, self.localizer, [self._vo], self._watch, stop=self._stop, sinks=sinks,
            result=self.result, look=look,
        )  # fmt: skip

    def see(self, frame: Frame) -> None:
        """Take a frame of a camera that has just captured it."""
        self.meter.frame(frame.t_ns, frame.arrival_ns or frame.t_ns, frame.t_ns)
        self.latest.put(frame)

    def ends_with(self, ended: threading.Event) -> None:
        """End the loop once its source has ended and all that came is looked at."""

        def close() -> None:
            ended.wait()
            self.latest.close()
            self.detection.join()
            self.events.close()

        threading.Thread(target=close, name="end of source", daemon=True).start()

    def end(self) -> None:
        """Put all away; within a second."""
        self.latest.close()
        self.events.close()
        self.detection.join(0.2)
        self.bridge.stop()
        if self.recorder is not None:
            self.recorder.stop()
        if self.view is not None:
            self.view.close()

    def status(self, rates: Rates, now_s: float) -> dict[str, Any]:
        """All figures, for the status file and the log."""
        ages, heard, offset = self.bridge.asked(_link_figures)
        belief, alarms = self.bridge.asked(_belief_figures)
        health, signs = self.localizer.health, self.localizer.health.signs
        figures, result = self.meter.figures(), self.result
        for text in result.unmapped.news(self._tag_map, result.with_pose):
            LOG.warning("%s", text)
        noise = self.localizer.filter.noise_words
        if noise is not None and not self._noise_said:
            self._noise_said = True
            LOG.warning("%s", noise)
            self.bridge.say("the IMU is noisier than stated: see the log", True)
        counts = {
            "frames": result.frames,
            "with_pose": result.with_pose,
            "imu": result.imu,
            "messages": figures.messages,
        }
        hz = {name: round(rates.per_second(name, n, now_s), 1) for name, n in counts.items()}
        latency = None if ages is None else {"p50": round(ages.p50, 2), "p99": round(ages.p99, 2)}
        sigma = None
        if signs is not None:
            sigma = {"m": round(signs.sigma_m, 5), "deg": round(signs.sigma_deg, 4)}
        return {
            "state": health.state.value,
            "reasons": list(health.reasons),
            "vehicle": heard,
            "clock_offset_s": offset,
            "belief": belief,
            "alarms": alarms,
            "setup": self.setup.status(),
            "counts": counts,
            "rates_hz": hz,
            "latency_ms": latency,
            "timing_ms": self._timing(),
            "cpu": self._cpu(rates, now_s),
            "sigma": sigma,
            "recording": None if self.recorder is None else self._recording(self.recorder),
            "tags_not_on_map": {str(t): n for t, n in sorted(result.unmapped.not_on_map.items())},
            "counters": self._counters(),
            "line": _line(health.state.value, hz, latency, sigma),
        }

    def _timing(self) -> dict[str, dict[str, float]]:
        """By stage; loop: all that the loop does with a frame whose tags are known."""
        timing = {**self._watch.summary(), **self.detection.watch.summary()}
        return {"loop" if stage == "total" else stage: ms for stage, ms in timing.items()}

    def _cpu(self, rates: Rates, now_s: float) -> dict[str, float]:
        """Share of a core that each thread takes; MainThread is the loop."""
        ticks = {name: round(1e3 * s) for name, s in cpu_by_thread().items()}
        share = {n: 1e-3 * rates.per_second(f"cpu {n}", ms, now_s) for n, ms in ticks.items()}
        return {name: round(part, 3) for name, part in sorted(share.items())}

    def _recording(self, recorder: Recorder) -> dict[str, str | None]:
        return {"folder": recorder.path, "stopped": recorder.stopped}

    def _counters(self) -> dict[str, int]:
        link, sent = self.bridge.asked(
            lambda c: (dict(c.counters), {f"pose_{k}": n for k, n in c.policy.counters.items()})
        )
        parts: list[dict[str, int]] = [
            {f"link_{k}": n for k, n in self.bridge.counters.copy().items()},
            link, sent, self.events.counters.copy(), self.detection.counters.copy(),
            dict(self.localizer.counters), dict(self.result.reasons),
            *(c.copy() for c in self._more),
            {"frames_skipped": self.latest.dropped},
            {} if self.recorder is None else self.recorder.counters.copy(),
            {} if self.view is None else self.view.counters.copy(),
        ]  # fmt: skip
        merged: dict[str, int] = {}
        for part in parts:
            merged |= part
        return {name: n for name, n in sorted(merged.items()) if n}


def _nowhere(t_ns: int) -> PosePrior | None:
    return None


def _link_figures(companion: Any) -> tuple[Ages | None, str | None, float | None]:
    known = companion.vehicle.system is not None
    clock = companion.clock
    offset = None if clock is None else round(clock.offset_ns * 1e-9, 6)
    return companion.ages.ages(), companion.vehicle.name if known else None, offset


def _belief_figures(companion: Any) -> tuple[dict[str, Any], dict[str, str]]:
    """What the autopilot believes against what was sent, and all alarms."""
    belief = companion.belief
    figures: dict[str, Any] = {"state": "unknown", "position_m": None, "yaw_deg": None, "count": 0}
    if belief is not None:
        figures = {
            "state": belief.state.value,
            "position_m": round(belief.position_m, 3),
            "yaw_deg": round(belief.yaw_deg, 2),
            "count": belief.count,
        }
    return figures, dict(companion.alarms)


def _line(
    state: str,
    hz: dict[str, float],
    latency: dict[str, float] | None,
    sigma: dict[str, float] | None,
) -> str:
    """The status in one line."""
    frames, imu, sent = (round(hz[name]) for name in ("frames", "imu", "messages"))
    text = f"{state}: {frames} frames/s, {imu} IMU/s, {sent} sent/s"
    if latency is not None:
        text += f", {latency['p50']:.0f} ms old (p99 {latency['p99']:.0f})"
    return text if sigma is None else text + f", sigma {sigma['m'] * 100:.1f} cm"


def start_status(flight: Flight, file: Path | None, systemd: Systemd) -> Status:
    """The status of a flight, running."""
    status = Status(flight.status, file, systemd)
    status.start()
    return status
