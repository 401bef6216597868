"""The bridge's brain: what is heard and what the filter says in, messages to send out.

It owns no thread, no socket and no clock: every call says what time it is, in the one monotonic
clock of this computer, in which poses are stamped, TIMESYNC is answered and IMU samples arrive.
"""

import logging
from collections import Counter, deque
from typing import Any

import numpy as np

from tagvo.geometry import Array
from vio.config.filter import HealthConfig
from vio.config.mavlink import MavlinkConfig
from vio.filter.health import Health
from vio.frames import Alignment, NedPose, largest_sigmas, to_ned
from vio.mavlink import messages
from vio.mavlink.belief import BeliefCheck, sent_pose
from vio.mavlink.clock import Asker, ClockTrack, learn, to_ours
from vio.mavlink.heading import Heading
from vio.mavlink.latency import AgeMeter, delay_advice
from vio.mavlink.message_rates import StreamRequest
from vio.mavlink.messages import Outgoing
from vio.mavlink.origin import OriginKeeper
from vio.mavlink.resets import ResetCounter
from vio.mavlink.send_policy import Rules, SendPolicy, Verdict
from vio.mavlink.status_text import Speaker
from vio.mavlink.vehicle import Vehicle
from vio.records import Moment

LOG = logging.getLogger("vio.mavlink")
_SECOND = 1_000_000_000
_MUTE_NS = _SECOND  # the filter has said nothing for so long: it is not trusted
_ATTITUDE_HZ = 20.0
_BELIEF_HZ = 5.0  # enough for a word after two seconds
_SILENT_NS, _BOOTS_NS = 3 * _SECOND // 2, 5 * _SECOND  # no boot is quicker; back since so long
_UNANSWERED_NS = 3 * _SECOND  # 30 questions without an answer
_STEEP_RAD = 1.0  # beyond so much pitch a yaw says little
_NEVER = -(1 << 62)


class Companion:
    """Companion computer of one vehicle.

    `heard` takes messages, `due` is called when `due_ns` comes, `offer` takes the filter's states;
    each returns what is to be sent now. `clock` maps the autopilot's stamps to ours.
    """

    def __init__(
        self,
        config: MavlinkConfig,
        R_BI: Array,
        p_BI: Array,
        first_counter: int,
        message_ids: dict[str, int],
        limits: HealthConfig | None = None,
        mute: bool = False,
    ) -> None:
        """R_BI (3, 3), p_BI (3,): I in the vehicle's body; message_ids: MAVLink's, by name; limits:
        `vio.health`, beyond whose sigmas no pose leaves; mute: tell the ground nothing."""
        self.config = config
        self.vehicle = Vehicle(config)
        self.resets = ResetCounter(first_counter)
        self.heading = Heading(config, R_BI)
        self.origin = OriginKeeper(config.origin)
        self.policy = SendPolicy(_rules(config, limits or HealthConfig()))
        self.ages = AgeMeter()
        self.clock: ClockTrack | None = None
        self.counters: Counter[str] = Counter()
        self.imu = _stream(config.imu.message, message_ids, config.imu.rate_hz)
        self._attitude = _stream("ATTITUDE", message_ids, _ATTITUDE_HZ)
        self.belief = None if config.belief is None else BeliefCheck(config.belief)
        names = ("LOCAL_POSITION_NED", "ATTITUDE") if self.belief is not None else ()
        self._told = [StreamRequest(n, message_ids[n], _BELIEF_HZ, listens=True) for n in names]
        self.alarms: dict[str, str] = {}
        self._signs_since_ns: int | None = None  # the autopilot signs, and we do not
        self._R_BI, self._p_BI = R_BI, p_BI
        self.asker, self._speaker = Asker(), Speaker(mute)
        self._health: Health | None = None
        self._offered_ns = self._heartbeat_ns = self._asked_ns = _NEVER
        self._uptime_ns: dict[str, int] = {}  # of the autopilot, as each of its clocks tells it
        self._restarted_ns = self._back_ns = _NEVER
        self._frame_ns: int | None = None
        self._waits_for: StreamRequest | None = None  # whose question is not answered yet
        self._waits_since = _NEVER
        self._waiting: deque[tuple[int, list[Outgoing]]] = deque()  # poses, and when they may leave
        self._withheld = False

    # what is heard

    def heard(self, message: Any, now_ns: int) -> list[Outgoing]:
        """Take a decoded message that arrived at now_ns."""
        name = message.get_type()
        if name == "HEARTBEAT" and self.vehicle.heartbeat(message, now_ns):
            self._speaker.say(f"connected to {self.vehicle.name}", messages.INFO)
        if not self.vehicle.is_mine(message):
            return []
        if self._frame_ns is not None and now_ns - self._frame_ns > _SILENT_NS:
            self._back_ns = now_ns
        self._frame_ns = now_ns
        if self.signs(message) and self._signs_since_ns is None:
            self._signs_since_ns = now_ns
        if name == "TIMESYNC":
            return self._timesync(message, now_ns)
        if self.imu is not None and name == self.imu.name:
            self.imu.arrived(now_ns)
        elif name == "ATTITUDE":
            self._take_attitude(message, now_ns)
        elif name == "LOCAL_POSITION_NED":
            self._take_position(message, now_ns)
        elif name == "GPS_GLOBAL_ORIGIN":
            self.origin.heard(message)
        elif name == "SYSTEM_TIME":
            self._up_for("SYSTEM_TIME", message.time_boot_ms * 1_000_000, now_ns)
        elif name == "COMMAND_ACK" and message.command == messages.SET_MESSAGE_INTERVAL:
            if self._waits_for is not None:
                self._waits_for.acknowledged(message.result)
            self._waits_for = None
        return []

    def _timesync(self, message: Any, now_ns: int) -> list[Outgoing]:
        if message.tc1 == 0:
            self.counters["timesync_answered"] += 1
            return [messages.timesync(message.ts1, now_ns)]
        exchange = self.asker.answered(message.ts1, message.tc1, now_ns)
        if exchange is None:
            self.counters["timesync_of_others"] += 1
            return []
        self._up_for("TIMESYNC", message.tc1, now_ns)
        before, self.clock = self.clock, learn(self.clock, exchange)
        if before is not None and self.clock is not None and self.clock.epoch != before.epoch:
            step_s = (self.clock.offset_ns - before.offset_ns) * 1e-9
            LOG.warning("the autopilot's clock has moved against ours by %.3f s", -step_s)
            self.counters["clock_steps"] += 1
        return []

    def _take_attitude(self, message: Any, now_ns: int) -> None:
        self._arrived("ATTITUDE", now_ns)
        t_ns = self._in_ours(message.time_boot_ms, now_ns)
        if self.belief is not None and abs(message.pitch) < _STEEP_RAD:
            self.belief.yaw(t_ns, message.yaw)
        if self._attitude is None or not self.heading.sought:
            return
        self._attitude.arrived(now_ns)
        self.heading.attitude(t_ns, message.yaw)

    def _take_position(self, message: Any, now_ns: int) -> None:
        self._arrived("LOCAL_POSITION_NED", now_ns)
        if self.belief is not None:
            p_NB = np.array([message.x, message.y, message.z])
            self.belief.position(self._in_ours(message.time_boot_ms, now_ns), p_NB)

    def _in_ours(self, boot_ms: int, now_ns: int) -> int:
        return now_ns if self.clock is None else to_ours(self.clock, boot_ms * 1_000_000)

    def _arrived(self, name: str, now_ns: int) -> None:
        for stream in self._told:
            if stream.name == name:
                stream.arrived(now_ns)

    def signs(self, message: Any) -> bool:
        """Whether a message is signed and nobody gave us a key: such an autopilot drops ours."""
        return self.config.signing is None and bool(message.get_header().incompat_flags & 1)

    def _up_for(self, clock: str, uptime_ns: int, now_ns: int) -> None:
        """Take the autopilot's time since its start; where it has gone back, all is forgotten."""
        before = self._uptime_ns.get(clock, uptime_ns)
        self._uptime_ns[clock] = uptime_ns
        if uptime_ns > before - _SECOND or now_ns - self._restarted_ns < 5 * _SECOND:
            return
        self._restarted_ns = now_ns
        LOG.warning("%s has started again", self.vehicle.name)
        self.counters["autopilot_restarts"] += 1
        self.origin.restarted(now_ns - self._back_ns < _BOOTS_NS)
        for stream in (self.imu, self._attitude, *self._told):
            if stream is not None:
                stream.restarted()

    # what is due

    @property
    def due_ns(self) -> int:
        """When `due` wants to be called next."""
        due_ns = min(self._heartbeat_ns + _SECOND, self._asked_ns + self._ask_every)
        return min(due_ns, self._waiting[0][0]) if self._waiting else due_ns

    @property
    def _ask_every(self) -> int:
        return round(_SECOND / self.config.timesync_hz)

    def due(self, now_ns: int) -> list[Outgoing]:
        """All that time itself asks for."""
        out: list[Outgoing] = []
        while self._waiting and self._waiting[0][0] <= now_ns:
            waited = self._waiting.popleft()[1]
            late = sum(self.expired(message, now_ns) for message in waited)
            self.counters["held_too_old"] += late
            out += [] if late else waited
        if now_ns - self._heartbeat_ns >= _SECOND:
            self._heartbeat_ns = now_ns
            out.append(messages.heartbeat(self._status(now_ns)))
        asks = now_ns - self._asked_ns >= self._ask_every
        self._asked_ns = now_ns if asks else self._asked_ns
        if not self.vehicle.alive(now_ns):
            return out
        if asks:
            out.append(messages.timesync(self.asker.ask(now_ns), 0))
        self._look_at_signing(now_ns)
        out += self.origin.due(self.vehicle, now_ns)
        out += self._stream_questions(now_ns)
        return out + self._speaker.due(now_ns)

    def expired(self, message: Outgoing, now_ns: int) -> bool:
        """Whether it is a pose that is too old to leave: to be asked directly before the write."""
        return message.t_ns is not None and now_ns - message.t_ns > self.policy.rules.max_age_ns

    def _stream_questions(self, now_ns: int) -> list[Outgoing]:
        """One question at a time: an answer does not say which message it is about."""
        if self._waits_for is not None and now_ns - self._waits_since < _SECOND:
            return []
        told = [self._attitude] if self.heading.sought else self._told
        for stream in (self.imu, *told):
            question = [] if stream is None else stream.due(self.vehicle, now_ns)
            if question:
                self._waits_for, self._waits_since = stream, now_ns
                return question
        return []

    def _status(self, now_ns: int) -> int:
        mute = self._health is not None and now_ns - self._offered_ns > _MUTE_NS
        return (
            messages.CRITICAL if mute else messages.system_status(self._health, bool(self.alarms))
        )

    def alarm(self, name: str, text: str | None) -> None:
        """Set an alarm, or clear it (None); while one is set HEARTBEAT is critical."""
        if text is None:
            if self.alarms.pop(name, None) is not None:
                LOG.warning("%s: well again", name)
                self.say(f"{name}: well again", messages.INFO)
        elif self.alarms.get(name) != text:
            self.counters[f"alarm_{name}"] += name not in self.alarms
            self.alarms[name] = text
            LOG.warning("%s: %s", name, text)
            self.say(text, messages.ERROR)

    def _look_at_signing(self, now_ns: int) -> None:
        since = self._signs_since_ns
        if self.clock is not None:
            self.alarm("signing", None)
        elif since is not None and now_ns - since > _UNANSWERED_NS:
            self.alarm("signing", "autopilot signs, answers nothing: mavlink.signing.key_file")

    def wrote(self, message: Outgoing) -> None:
        """Take a message that has left; of a pose: say where the autopilot differs, and when it no
        longer does. One that was decided on and never left is not what it was told."""
        pose = None if self.belief is None else sent_pose(message.name, message.fields)
        if self.belief is None or pose is None:
            return
        before = self.belief.state
        self.belief.sent(pose, message.fields["reset_counter"])
        if self.belief.state is not before:
            self.alarm("belief", self.belief.words())

    def say(self, text: str, severity: int) -> None:
        """Have the ground station read something, when its turn comes."""
        self._speaker.say(text, severity)

    def farewell(self) -> list[Outgoing]:
        """The last words."""
        return self._speaker.at_once("stopped: no more poses", messages.WARNING)

    # what the filter says

    def wanted(self, now_ns: int) -> int | None:
        """The stamp for which a state is wanted now, besides those at captures; None: for none.

        One that fills in for captures is as old as they are when they leave: ArduPilot takes the
        least age that it meets for zero, and a fresh one would shift all others.
        """
        if not self.policy.hungry(now_ns):
            return None
        if not self.policy.rules.at_capture:
            return now_ns
        least_ns = self.ages.least_ns
        return None if least_ns is None else now_ns - least_ns

    def note(self, health: Health, now_ns: int) -> None:
        """Take the filter's word on itself where there is no state to offer."""
        self._health, self._offered_ns = health, now_ns
        self._speaker.health(health)

    def offer(self, moment: Moment, health: Health, captured: bool, now_ns: int) -> list[Outgoing]:
        """Take a state of the filter: at the capture of a frame, or one that was `wanted`."""
        self.note(health, now_ns)
        if not _finite(moment):
            self.counters["held_not_finite"] += 1
            return []
        if self.resets.look(moment, health.state, health.resets, self.vehicle.armed):
            self.heading.relevelled()
            LOG.info("the pose has jumped (%s): reset counter %d",
                     self.resets.causes[-1], self.resets.value)  # fmt: skip
        if self.resets.levelling is not None:
            self.heading.state(moment.t_ns, moment.nav, self.resets.levelling)
        pose = self._in_ned(moment)
        why = self._why_held(pose, now_ns)
        if why:
            self.counters[f"held_{why}"] += 1
        leaves_ns = self.policy.leaves_at(now_ns)
        verdict = self.policy.decide(
            moment.t_ns, captured, health.state, now_ns, bool(why), largest_sigmas(pose)
        )
        if verdict is Verdict.COASTED and not self._withheld:
            self._withheld = True
            self._speaker.say("has coasted long enough: pose withheld", messages.WARNING)
        if verdict is not Verdict.SEND or pose is None:
            return []
        self._withheld = False
        if captured:
            self.ages.add(leaves_ns - moment.t_ns)
        out = self._messages(moment.t_ns, pose, health)
        if leaves_ns <= now_ns:
            return out
        self._waiting.append((leaves_ns, out))
        return []

    def _in_ned(self, moment: Moment) -> NedPose | None:
        levelling, heading = self.resets.levelling, self.heading.rad
        if levelling is None or heading is None:
            return None
        alignment = Alignment(levelling, heading, self._R_BI, self._p_BI)
        return to_ned(moment.nav, alignment, moment.w_I)

    def _why_held(self, pose: NedPose | None, now_ns: int) -> str:
        """Why nothing can be sent now, whatever it is; or an empty text."""
        if self.vehicle.system is None:
            return "no_autopilot"
        if not self.origin.ready(now_ns):
            return "no_origin"
        if pose is None:
            return "no_heading"
        return "unsaved_reset" if self.resets.unsaved else ""

    def _messages(self, t_ns: int, pose: NedPose, health: Health) -> list[Outgoing]:
        counter = self.resets.value
        if self.config.message == "ODOMETRY":
            frame = messages.odometry_frame(self.vehicle.autopilot or 0)
            return [messages.odometry(t_ns, pose, counter, frame, messages.quality(health))]
        out = [messages.vision_position_estimate(t_ns, pose, counter)]
        speed = messages.vision_speed_estimate(t_ns, pose, counter) if self.config.speed else None
        return out if speed is None else [*out, speed]

    # what there is to know

    def delay_advice(self) -> str | None:
        """The autopilot's delay parameter as measured; None before the first pose."""
        ages = self.ages.ages()
        if ages is None or self.vehicle.autopilot is None:
            return None
        one_way = 0.0 if self.clock is None else 0.5e-6 * min(self.clock.rtts_ns)
        synced = self.counters["timesync_answered"] > 0
        return delay_advice(ages, one_way, self.vehicle.autopilot, synced)


def _finite(moment: Moment) -> bool:
    """Whether all is that a pose is made of; its covariance may be what it is."""
    nav = moment.nav
    parts = [nav.p_WI, nav.R_WI, moment.w_I, moment.down_W]
    parts += [] if nav.v_WI is None else [nav.v_WI]
    return all(np.isfinite(part).all() for part in parts)


def _rules(config: MavlinkConfig, limits: HealthConfig) -> Rules:
    return Rules(
        config.rate_hz,
        round(config.max_age_s * 1e9),
        round(config.coast_s * 1e9),
        config.valid_at == "capture",
        limits.lost_sigma_m,
        limits.lost_sigma_deg,
    )


def _stream(name: str, ids: dict[str, int], rate_hz: float) -> StreamRequest | None:
    return None if name == "none" else StreamRequest(name, ids[name], rate_hz)
