"""`tagvio daemon` and `tagvio replay` without their words: what each puts together and runs."""

import gc
import logging
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from tagvo.detect.rejection import filter_detections
from tagvo.pipeline import TagVO
from tagvo.records import Frame
from vio.config import Config
from vio.daemon.flight import Counters, Flight, start_status
from vio.daemon.ground_detector import GroundJudge
from vio.daemon.log_player import Player
from vio.daemon.memory import give_back
from vio.daemon.preflight import (
    Parts,
    check_recording,
    imu_in_body,
    new_recording,
    read_parts,
)
from vio.daemon.recorder import Recorder
from vio.daemon.status import waiting_status, write_status
from vio.daemon.systemd import Systemd
from vio.daemon.time_base import FlightClock
from vio.errors import LinkError, LogError, VioError
from vio.localize.run import RunResult
from vio.localize.warmup import warm_all
from vio.mavlink.bridge import Bridge
from vio.records import Ground, ImuSample
from vio.setup_check.unmapped_tags import UnmappedTags, other_family
from vio.sinks.live_view import LiveView
from vio.sources.flight_log.log import FlightLog
from vio.sources.live.grab import Grabber, open_camera
from vio.sources.live.imu import MavlinkImu
from vio.sources.live.live_camera import LiveCamera

LOG = logging.getLogger("vio.daemon")
_LOOK_S = 0.25
_SWITCH_S = 1e-3
_LEAD_NS = 1_500_000_000  # to the first event of a log: the detector gets ready meanwhile
_REPLAY_WAIT_S = 10.0
_SAY_WAITING_S, _WRITE_WAITING_S = 10.0, 1.0  # a line for a person, the file as in flight


def fly(config: Config, path: Path, stop: Callable[[], bool]) -> RunResult | None:
    """Fly with a configuration (of the file at path) until stop; None: stopped before it began.

    Everything is checked before anything is sent; raises in one line what only the user can mend.
    """
    parts, bridge, open_it = check(config, path)
    where = path.parent
    systemd = Systemd()
    sys.setswitchinterval(_SWITCH_S)  # the link answers TIMESYNC while compiled code is loaded
    with _link(bridge), _loading(parts) as loaded:
        systemd.tell("READY=1", "STATUS=waiting for the flight controller")
        file = _status_file(config, where)
        if not _met(bridge, config.daemon.vehicle_wait_s, stop, systemd, file):
            return None
        recorder = _recorder(parts, where, bridge)
        counters: Counters = []
        flight = Flight(parts, bridge, stop, recorder, FlightClock(), counters)
        imu = MavlinkImu(bridge.companion, imu_in_body(config)[0], _taker(flight, config))
        camera = LiveCamera(open_it, flight.see, bridge.say)
        counters += [imu.counters, camera.counters]
        bridge.listen(imu.heard)
        flight.view = _view(flight, parts, where, time.time_ns() - time.monotonic_ns())
        return _fly(flight, camera, systemd, file, loaded)


@contextmanager
def _loading(parts: Parts) -> Iterator[Callable[[], None]]:
    """Load compiled code beside all else: what a filter starts from is gathered meanwhile.

    Gives a function that waits for it; it raises what went wrong there.
    """
    config = parts.config
    with ThreadPoolExecutor(1, "compiled code") as pool:
        job = pool.submit(warm_all, parts.tag_map, parts.camera, config.tagvo, config.vio)
        yield job.result


def _settle() -> None:
    """What is loaded stays: the collector need not look through it again, up to 0.1 s a time.

    The compiler goes, and no thread of Python's keeps another waiting for long.
    """
    gc.freeze()
    give_back("libllvmlite")
    sys.setswitchinterval(_SWITCH_S)


def check(config: Config, path: Path) -> tuple[Parts, Bridge, Callable[[], Grabber]]:
    """All that a flight needs, looked at and opened where it can be; nothing is sent."""
    parts, where = read_parts(config, path), path.parent
    bridge = Bridge(config.mavlink, *imu_in_body(config), config.vio.health)
    open_it = partial(open_camera, config.daemon.camera, parts.camera.resolution, where)
    open_it().close()
    check_recording(config, where)
    return parts, bridge, open_it


def tags_in_sight(parts: Parts, open_it: Callable[[], Grabber]) -> list[str]:
    """What is wrong with the tags that the camera sees now, in words; none: nothing is."""
    grabber = open_it()
    try:
        shot = grabber.read()
    finally:
        grabber.close()
    if shot is None:
        return []
    vo, seen = TagVO(parts.camera, parts.tag_map, parts.config.tagvo), UnmappedTags()
    found = vo.detect(Frame(shot.t_ns, shot.image))
    counts = filter_detections(
        found, parts.tag_map, parts.config.tagvo.filters, parts.camera.resolution
    )[2]
    seen.take(found, counts, parts.tag_map)
    other = None if len(found) else other_family([shot.image], parts.tag_map.family.name)
    return [*seen.words(parts.tag_map, 0), *([] if other is None else [other])]


def _recorder(parts: Parts, where: Path, bridge: Bridge) -> Recorder | None:
    try:
        writer = new_recording(parts, where)
    except OSError as err:  # a full disk is no reason to stay on the ground
        LOG.warning("%s; this flight is not recorded", err)
        bridge.say("not recording: disk", True)
        return None
    if writer is None:
        return None
    LOG.info("recording to %s", writer.path)
    return Recorder(writer, parts.config.daemon.record, bridge.say)


def _view(flight: Flight, parts: Parts, where: Path, epoch_ns: int) -> LiveView | None:
    """The live view, where one is wanted; a flight does not wait for want of it."""
    live = parts.config.daemon.live
    if live.port is None and live.mcap is None:
        return None
    name = time.strftime("flight-%Y%m%d-%H%M%S.mcap")
    file = None if live.mcap is None else where / Path(live.mcap).expanduser() / name
    try:
        view = LiveView(
            parts.tag_map, parts.camera, port=live.port, host=live.host, mcap=file,
            beliefs=flight.localizer.filter, reject_weight=parts.config.tagvo.joint.reject_weight,
            epoch_ns=epoch_ns, origins=live.origins,
        )  # fmt: skip
    except (VioError, OSError) as err:
        LOG.warning("%s; this flight is flown without it", err)
        return None
    if view.port is not None:
        LOG.info("live view at ws://%s:%d (Foxglove)", live.host, view.port)
    return view


def _taker(flight: Flight, config: Config) -> Callable[[ImuSample], None]:
    """What becomes of each IMU sample: an event, and a word on the ground beside it."""
    judge, vehicle = GroundJudge(config.vio), flight.bridge.companion.vehicle

    def take(sample: ImuSample) -> None:
        flight.events.put(sample)
        stands = judge.take(sample, vehicle.armed)
        if stands is not None:
            flight.events.put(Ground(sample.arrival_ns, stands))

    return take


def _fly(
    flight: Flight,
    camera: LiveCamera,
    systemd: Systemd,
    file: Path | None,
    loaded: Callable[[], None],
) -> RunResult:
    status = start_status(flight, file, systemd)
    try:
        flight.ready()
        camera.start()
        flight.ends_with(camera.ended)
        loaded()
        _settle()
        return flight.fly()
    finally:
        systemd.tell("STOPPING=1")
        camera.stop(0.2)
        flight.end()
        status.stop()
        systemd.close()


def _status_file(config: Config, where: Path) -> Path | None:
    file = config.daemon.status_file
    return None if file is None else where / Path(file).expanduser()


@contextmanager
def _link(bridge: Bridge) -> Iterator[None]:
    """The bridge, started; it is stopped whatever happens."""
    try:
        bridge.start()
        yield
    finally:
        bridge.stop()


def _met(
    bridge: Bridge,
    patience_s: float,
    stop: Callable[[], bool],
    systemd: Systemd,
    file: Path | None = None,
) -> bool:
    """Wait for the vehicle, and say so; false: told to stop. LinkError where none comes in time.

    file: the status file, which says it each second.
    """
    began = said = wrote = time.monotonic()
    until = began + patience_s
    LOG.info("waiting for an autopilot at %s", bridge.config.url)
    write_status(file, waiting_status(bridge.config.url, 0.0))
    while not stop():
        now = time.monotonic()
        left = until - now
        if now - said >= _SAY_WAITING_S:
            said = now
            LOG.warning("still waiting: %s", bridge.no_vehicle(round(now - began)))
        if now - wrote >= _WRITE_WAITING_S:
            wrote = now
            write_status(file, waiting_status(bridge.config.url, now - began))
        try:
            bridge.wait_for_vehicle(min(_LOOK_S, max(left, 0.01)))
            return True
        except LinkError:
            if left <= 0.0:
                raise bridge.no_vehicle(patience_s) from None
        systemd.tell("WATCHDOG=1")
    return False


@dataclass(frozen=True, slots=True)
class Replayed:
    """What a replay came to: what was played, the run, its last status, its share of a core."""

    frames: int
    imu: int
    result: RunResult
    status: dict[str, Any]
    figures: Any
    cpu_share: float
    advice: str | None


def replay(
    log: FlightLog,
    config: Config,
    speed: float,
    stop: Callable[[], bool],
    each_frame: Callable[[], None] = lambda: None,
) -> Replayed | None:
    """Play a log into the flight controller at the end of config.mavlink; None: stopped early."""
    if log.imu is None:
        raise LogError(f"{log.path}: no IMU; the filter that flies needs mav0/imu0/data.csv")
    parts = Parts(config, log.tag_map, log.camera, log.imu_noise, {})
    link = config.mavlink.model_copy(
        update={"imu": config.mavlink.imu.model_copy(update={"message": "none"})}
    )
    bridge = Bridge(link, *imu_in_body(config), config.vio.health)
    warm_all(log.tag_map, log.camera, config.tagvo, config.vio)
    _settle()
    with _link(bridge):
        if not _met(bridge, _REPLAY_WAIT_S, stop, Systemd({})):
            return None
        first = min(int(log.imu.arrival_ns.min()), int(log.frames.received_ns.min()))
        clock = FlightClock(first, time.monotonic_ns() + _LEAD_NS, speed)
        flight = Flight(parts, bridge, stop, None, clock, [])
        flight.view = _view(flight, parts, Path.cwd(), 0)
        player = Player(log, flight.events, flight.latest, flight.meter, each_frame)
        flight.ready()
        status = start_status(flight, None, Systemd({}))
        cpu, start = time.process_time(), time.monotonic()
        player.start(clock)
        flight.ends_with(player.ended)
        try:
            result = flight.fly()
        finally:
            share = (time.process_time() - cpu) / (time.monotonic() - start)
            player.stop()
            advice = bridge.asked(lambda companion: companion.delay_advice())
            flight.end()
            status.stop()
    figures = flight.meter.figures()
    return Replayed(player.frames, player.imu, result, status.latest, figures, share, advice)
