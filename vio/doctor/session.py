"""The doctor's end of a live link: messages wait in an inbox, the main thread answers them."""

import queue
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from vio.config.mavlink import ImuLinkConfig, MavlinkConfig
from vio.doctor.collect import Examiner
from vio.doctor.hand_test_samples import HandTestSamples
from vio.doctor.params import ParamWriter
from vio.doctor.records import Change, Facts
from vio.errors import LinkError
from vio.mavlink.bridge import Bridge, now_ns
from vio.mavlink.endpoint import check_baud, parse_url
from vio.mavlink.messages import Outgoing

_TURN_S = 0.01
_REST_NS, _MOST_REST_NS = 1_000_000_000, 5_000_000_000
_WRITE_NS = 60_000_000_000


class _Ear(Protocol):
    def heard(self, message: Any, now_ns: int) -> None: ...
    def due(self, now_ns: int) -> list[Outgoing]: ...


class Line:
    """Connects, examines, writes; `close` gives the link back. LinkError where it cannot be had."""

    def __init__(self, config: MavlinkConfig) -> None:
        """config: as it will fly."""
        self._config = config
        self._bridge = Bridge(_harmless(config), np.eye(3), np.zeros(3), mute=True)
        self._inbox: queue.SimpleQueue[tuple[Any, int]] = queue.SimpleQueue()
        self._bridge.listen(lambda message, t: self._inbox.put((message, t)))

    def connect(self, timeout_s: float) -> str:
        """Open the link and wait for the autopilot; what it is."""
        self._bridge.start()
        name = self._bridge.wait_for_vehicle(timeout_s)
        return f"{name}, system {self._bridge.companion.vehicle.system}"

    def examine(self, seconds: float) -> tuple[Facts, dict[str, int]]:
        """The facts after `seconds` of listening or more, and the types of the parameters."""
        examiner = Examiner(self._bridge.companion, self._config, seconds, now_ns())
        self._pump(examiner, lambda: examiner.done(now_ns()))
        return examiner.facts(now_ns()), examiner.reader.kinds

    def write(self, changes: list[Change], kinds: dict[str, int]) -> dict[str, float | None]:
        """Write parameters and read them back; LinkError while the vehicle is armed."""
        vehicle = self._bridge.companion.vehicle
        if vehicle.armed:
            raise LinkError("the vehicle is armed: nothing is written; disarm it first")
        assert vehicle.system is not None
        assert vehicle.autopilot is not None
        writer = ParamWriter(vehicle.system, vehicle.autopilot, changes, kinds)
        end_ns = now_ns() + _WRITE_NS
        self._pump(writer, lambda: writer.done or vehicle.armed or now_ns() > end_ns)
        return writer.results

    def hand_test(self) -> HandTestSamples:
        """Begin to listen for positions and yaws; see `rest`."""
        vehicle = self._bridge.companion.vehicle
        assert vehicle.system is not None
        samples = HandTestSamples(vehicle)
        self._bridge.send(samples.questions(vehicle.system))
        return samples

    def rest(self, samples: HandTestSamples) -> None:
        """Wait for a second of rest, five at most, and have `samples` take the last one."""
        self._drain(samples)
        start_ns = now_ns()

        def done() -> bool:
            now = now_ns()
            if now - start_ns <= _REST_NS:
                return False
            return now - start_ns > _MOST_REST_NS or samples.still(now - _REST_NS)

        self._pump(samples, done)
        samples.rested(now_ns() - _REST_NS)

    def close(self) -> None:
        """Give the link back."""
        self._bridge.stop(farewell=False)

    def _pump(self, ear: _Ear, done: Callable[[], bool]) -> None:
        while not done():
            try:
                message, t = self._inbox.get(timeout=_TURN_S)
                ear.heard(message, t)
            except queue.Empty:
                pass
            self._bridge.send(ear.due(now_ns()))

    def _drain(self, ear: _Ear) -> None:
        while not self._inbox.empty():
            ear.heard(*self._inbox.get())


def _harmless(config: MavlinkConfig) -> MavlinkConfig:
    """The configuration to look with: sets no origin; asks for no IMU where the line is too slow,
    so that all else can still be looked at."""
    quiet = config.model_copy(update={"origin": None, "map_heading_deg": 0.0})
    try:
        check_baud(parse_url(config.url), config)
    except LinkError:
        quiet = quiet.model_copy(update={"imu": ImuLinkConfig(message="none")})
    return quiet
