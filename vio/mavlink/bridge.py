"""The link as it flies: one thread that reads, answers and keeps the link up; a lock for writers.

This is the edge: here alone the clock is read and sockets are waited for. All else is `Companion`.
"""

import logging
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from tagvo.geometry import Array
from vio.config.filter import HealthConfig
from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError
from vio.filter.health import Health
from vio.mavlink.codec import MESSAGE_IDS, Codec, read_key
from vio.mavlink.endpoint import check_baud, parse_url
from vio.mavlink.messages import INFO, WARNING, Outgoing
from vio.mavlink.persistent_state import Saved, first_counter, load_saved, save
from vio.mavlink.protocol import Companion
from vio.mavlink.traffic import Traffic
from vio.mavlink.transport import Peer, Transport, open_transport
from vio.mavlink.vehicle import NAMES, Binding, Claim, is_vehicle
from vio.records import Moment

LOG = logging.getLogger("vio.mavlink")
T = TypeVar("T")
Listener = Callable[[Any, int], None]
Watcher = Callable[[Outgoing, int], None]
_BACK_OFF_S = (0.2, 0.5, 1.0, 2.0, 5.0)
_LONGEST_S = 0.5  # that the reader waits without looking around
_DEAF_NS = 10_000_000_000  # a TCP connection over which nothing comes for so long is dead
_EPOCH_2015_S = 1420070400
_SIGNING_AHEAD = 60_000_000  # 10 minutes, in 10 us: reserved on disk at a time


def now_ns() -> int:
    """The one clock of the link: poses, TIMESYNC answers and arrivals are all in it."""
    return time.monotonic_ns()


class Bridge:
    """Connects a Companion to a link; `start` opens it, `offer` sends the filter's states."""

    def __init__(
        self,
        config: MavlinkConfig,
        R_BI: Array,
        p_BI: Array,
        limits: HealthConfig | None = None,
        mute: bool = False,
    ) -> None:
        """Checks all that can be checked without a link; raises LinkError. As of a Companion."""
        self.config = config
        self._address = parse_url(config.url)
        check_baud(self._address, config)
        key = None if config.signing is None else read_key(Path(config.signing.key_file))
        self._file = Path(config.state_file).expanduser()
        self._saved = load_saved(self._file)
        first = first_counter(self._saved, now_ns())
        self.companion = Companion(config, R_BI, p_BI, first, MESSAGE_IDS, limits, mute)
        self._codec = Codec(config.system_id or 1, config.component_id)
        self.binding, self._traffic = Binding(), Traffic()
        self.counters = self.binding.counters
        self._listeners: list[Listener] = []
        self._watchers: list[Watcher] = []
        self._brain, self._writer = threading.Lock(), threading.Lock()
        self._ready = threading.Condition()
        self._transport: Transport | None = None
        self._broken, self._data_ns = False, now_ns()
        self._stop = threading.Event()
        self._woken, self._waker = socket.socketpair()
        self._waker.setblocking(False)
        self._thread = threading.Thread(target=self._live, name="mavlink", daemon=True)
        if key is not None:
            self._sign(key)

    def _sign(self, key: bytes) -> None:
        signing = self.config.signing
        assert signing is not None
        start = max(_wall_10us(), self._saved.signing_timestamp + 1)
        self._codec.sign(key, signing.link_id, start, signing.accept_unsigned)

    def listen(self, listener: Listener) -> None:
        """Have a function called with every message and its arrival, in the reader's thread."""
        self._listeners.append(listener)

    def watch(self, watcher: Watcher) -> None:
        """Have a function called with every message that has left, and when, by who sent it."""
        self._watchers.append(watcher)

    def asked(self, question: Callable[[Companion], T]) -> T:
        """The answer to a question about the companion while nothing changes it."""
        with self._brain:
            return question(self.companion)

    def say(self, text: str, bad: bool) -> None:
        """Have the ground station read something; from any thread."""
        with self._brain:
            self.companion.say(text, WARNING if bad else INFO)

    def alarm(self, name: str, text: str | None) -> None:
        """Set an alarm of this name, or clear it (None); from any thread. See Companion.alarm."""
        with self._brain:
            self.companion.alarm(name, text)

    def start(self) -> None:
        """Open the link and begin; LinkError for what only the user can mend."""
        self._keep_on_disk()
        try:
            self._transport = open_transport(self._address)
        except OSError as err:
            LOG.warning("%s: %s; trying on", self.config.url, err.strerror or err)
        self._thread.start()

    def try_link(self) -> None:
        """Open the link and close it, nothing sent; fails, or warns, as `start` would."""
        try:
            open_transport(self._address).close()
        except OSError as err:
            LOG.warning("%s: %s; a flight would try on", self.config.url, err.strerror or err)

    def wait_for_vehicle(self, timeout_s: float) -> str:
        """The autopilot's name once it is heard; LinkError if none is that is known."""
        vehicle = self.companion.vehicle
        with self._ready:
            self._ready.wait_for(lambda: vehicle.system is not None, timeout_s)
        if vehicle.system is None:
            raise self.no_vehicle(timeout_s)
        return vehicle.name

    def no_vehicle(self, timeout_s: float) -> LinkError:
        """Why none was found in so long: the four kinds of a link without an autopilot differ."""
        return self.companion.vehicle.fault or LinkError(
            f"mavlink.url {self.config.url}: no heartbeat of an autopilot in {timeout_s:g} s (one"
            f" of {', '.join(NAMES.values())}): {self._traffic.words(self._codec.refused)}"
        )

    def wanted(self) -> int | None:
        """The stamp for which a state is wanted now, besides those at captures; None: for none."""
        with self._brain:
            return self.companion.wanted(now_ns())

    def offer(self, moment: Moment | None, health: Health, captured: bool) -> None:
        """Send a state of the filter, if it is time for it; None: there is none yet."""
        with self._brain:
            now = now_ns()
            if moment is None:
                self.companion.note(health, now)
                return
            due_ns = self.companion.due_ns
            out = self.companion.offer(moment, health, captured, now)
            sooner = self.companion.due_ns < due_ns
            unsaved = self.companion.resets.unsaved
        self._send(out)
        if unsaved or sooner:
            self._wake()

    def send(self, messages: list[Outgoing]) -> None:
        """Send these besides, such as questions for parameters."""
        self._send(messages)

    def stop(self, farewell: bool = True) -> None:
        """End the thread and give the link back; within a second.

        farewell: tell the ground station that no more poses come.
        """
        if self._stop.is_set():
            return
        if farewell and self._thread.is_alive():
            with self._brain:
                last_words = self.companion.farewell()
            self._send(last_words)
        self._stop.set()
        self._wake()
        if self._thread.ident is not None:
            self._thread.join(2.0)
        self._keep_on_disk()
        self._drop()
        self._woken.close()
        self._waker.close()

    # the reader's thread

    def _live(self) -> None:
        tries = 0
        while not self._stop.is_set():
            try:
                if self._transport is None:
                    self._transport, self._data_ns = open_transport(self._address), now_ns()
                    self.counters["reconnected"] += 1
                    LOG.info("%s is open again", self.config.url)
                tries = 0
                self._turn(self._transport)
            except (OSError, LinkError) as err:
                if tries == 0:
                    LOG.warning("%s: %s; trying again", self.config.url, err)
                self._drop()
                self._stop.wait(_BACK_OFF_S[min(tries, len(_BACK_OFF_S) - 1)])
                tries += 1
            except Exception:  # a bug must not silence a vehicle in the air
                LOG.exception("the link goes on after a fault")
                self.counters["faults"] += 1
                self._stop.wait(0.05)

    def _turn(self, transport: Transport) -> None:
        """Wait for bytes, the next duty, or a call; do what there is to do."""
        wait_s = (self.companion.due_ns - now_ns()) * 1e-9
        readable, _, _ = select.select(
            [transport.fileno(), self._woken.fileno()], [], [], min(max(wait_s, 0.0), _LONGEST_S)
        )
        if self._woken.fileno() in readable:
            self._woken.recv(4096)
        if transport.fileno() in readable:
            data, peer = transport.read()
            arrival = now_ns()
            if data:
                self._data_ns = arrival
                self._take(data, peer, arrival, transport)
        if self._address.kind == "tcp" and now_ns() - self._data_ns > _DEAF_NS:
            raise OSError(f"silent for {_DEAF_NS * 1e-9:.0f} s")
        if self._broken:
            raise OSError("the link broke while sending")
        with self._brain:
            out = self.companion.due(now_ns())
            system = self.companion.vehicle.system
        if system is not None:
            self._codec.speak_as(system)
        self._send(out)
        self._keep_on_disk()

    def _take(self, data: bytes, peer: Peer, arrival: int, transport: Transport) -> None:
        self._traffic.bytes += len(data)
        for message in self._codec.decode(data):
            self.counters["heard"] += 1
            self._traffic.heard(message)
            if not self._admitted(message, peer, arrival, transport):
                continue
            with self._brain:
                out = self.companion.heard(message, arrival)
            self._send(out)
            if message.get_type() == "HEARTBEAT":
                self._met(peer, arrival, transport)
            for listener in self._listeners:
                listener(message, arrival)
        self.counters["broken"] = self._codec.bad
        self.counters["unknown"] = self._codec.unknown
        self._traffic.complain(self._codec.bad, arrival)

    def _admitted(self, message: Any, peer: Peer, arrival: int, transport: Transport) -> bool:
        """Whether a frame is heard at all: signed where the vehicle's must be, no claimant's."""
        vehicle = self.companion.vehicle
        mine = vehicle.is_mine(message)
        if self.config.signing is not None and not message.get_signed():
            self.counters["unsigned"] += mine
            return not mine
        other = message.get_type() == "HEARTBEAT" and not is_vehicle(message)
        ids = mine and vehicle.system is not None and not other
        claim = self.binding.judge(peer, ids, arrival)
        if peer is not None and peer == self.binding.address:
            transport.adopt(peer)
        return claim is not Claim.REFUSED

    def _met(self, peer: Peer, arrival: int, transport: Transport) -> None:
        """A heartbeat: bind to where the vehicle's first came from; tell who waits for it."""
        if self.binding.address is None:
            transport.adopt(peer)  # a router sends nothing to whom it has not heard
            if self.companion.vehicle.system is not None:
                self.binding.bind(peer, arrival)
        with self._ready:
            self._ready.notify_all()

    def _send(self, messages: list[Outgoing]) -> None:
        if not messages:
            return
        written = []
        with self._writer:
            transport = self._transport
            for message in messages:
                frame = self._codec.encode(message)
                now = now_ns()  # directly before the write: a process may be stopped anywhere
                if self.companion.expired(message, now):
                    self.counters["expired"] += 1
                    continue
                try:
                    sent = transport is not None and transport.write(frame)
                except OSError:
                    sent, self._broken = False, True
                    self._wake()
                self.counters["sent" if sent else "not_sent"] += 1
                written += [message] if sent and message.t_ns is not None else []
                for watcher in self._watchers if sent else ():
                    watcher(message, now)
        for message in written:
            with self._brain:
                self.companion.wrote(message)

    def _drop(self) -> None:
        with self._writer:
            transport, self._transport, self._broken = self._transport, None, False
        if transport is not None:
            transport.close()

    def _wake(self) -> None:
        with suppress(OSError):  # full: it is awake already; closed: it has ended
            self._waker.send(b"!")

    def _keep_on_disk(self) -> None:
        """Save a new reset counter before it is sent, and signing time before it is used up."""
        with self._writer:
            used = self._codec.timestamp if self.config.signing is not None else 0
            if used:
                self._codec.advance(_wall_10us())
                used = self._codec.timestamp
        resets = self.companion.resets
        value, reserved = resets.value, self._saved.signing_timestamp
        late = used > reserved - _SIGNING_AHEAD // 2
        if not resets.unsaved and not (used and late):
            return
        self._saved = Saved(value, used + _SIGNING_AHEAD if used and late else reserved)
        save(self._file, self._saved)
        resets.saved(value)


def _wall_10us() -> int:
    return int((time.time() - _EPOCH_2015_S) * 1e5)
