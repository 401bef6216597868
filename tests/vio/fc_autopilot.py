"""What both families of in-test autopilots share: clock, parser, control, commands, streams.

Written from what was measured and read of ArduPilot and PX4, never from the bridge's code.
"""

import numpy as np
from fc_vehicle import Ekf, turn
from pymavlink.dialects.v20 import ardupilotmega as m

STEP_NS = 10_000_000
SYSTEM = 1


class Autopilot:
    """One flight controller: `receive` bytes, `poll` at true times gives bytes to send.

    Its clock: (true time since boot) * (1 + drift) + what `wander(t)` adds [ns].
    """

    kind = None
    PARAMS = None  # name: (value, MAV_PARAM_TYPE)
    COMPASS = False  # its yaw is the compass', never vision's

    def __init__(self, vehicle, rng, boot_ns=0, drift=0.0, wander=None, system=SYSTEM):
        self.vehicle, self.rng, self.system = vehicle, rng, system
        self.drift, self.wander, self.step_ns = drift, wander or (lambda t: 0), 0
        self.mav = m.MAVLink(None, srcSystem=system, srcComponent=1)
        self.parser = m.MAVLink(None)
        self.parser.robust_parsing = True
        self.target, self.armed = None, False
        self.words = []
        self.params = dict(self.PARAMS)
        self.deaf_to = set()  # names of messages that get lost
        self.boot(boot_ns)

    def boot(self, t_ns):
        """Start with nothing in memory."""
        self.boot_ns, self.last_ns, self.step_ns = t_ns, t_ns, 0
        self.ekf = Ekf()
        self.origin = None
        self.reset_counter = None
        self.streams, self.sent_at = {}, {}
        self.heard = {}
        self.resets, self.rejected, self.fused = [], [], []
        self.aiding = self.armed = False
        self.out = []
        self.heartbeat_ns = self.system_time_ns = t_ns - 10**9

    def clock(self, t_ns):
        """This autopilot's time [ns] since its boot."""
        return (
            round((t_ns - self.boot_ns) * (1 + self.drift))
            + round(self.wander(t_ns))
            + self.step_ns
        )

    def send(self, message):
        self.out.append(bytes(message.pack(self.mav)))
        self.mav.seq = (self.mav.seq + 1) % 256

    def receive(self, data, t_ns):
        for message in self.parser.parse_buffer(data) or ():
            name = message.get_type()
            self.heard.setdefault(name, []).append((t_ns, message))
            if name in self.deaf_to:
                continue
            handler = getattr(self, f"on_{name.lower()}", None)
            if handler is not None:
                handler(message, t_ns)

    def poll(self, t_ns):
        """One loop at a true time; the bytes to send."""
        if t_ns - self.last_ns >= STEP_NS:
            self.fly(t_ns, (t_ns - self.last_ns) * 1e-9)
            self.last_ns = t_ns
        if t_ns - self.heartbeat_ns >= 10**9:
            self.heartbeat_ns = t_ns
            mode = 128 if self.armed else 0
            self.send(m.MAVLink_heartbeat_message(2, self.kind, mode, 0, 4, 3))
            self.send(m.MAVLink_system_time_message(0, self.clock(t_ns) // 10**6))
        self.loop(t_ns)
        out, self.out = self.out, []
        return out

    def fly(self, t_ns, dt):
        """Control on the estimate: what is wrong with it moves the true vehicle."""
        wanted = np.zeros(3)
        if self.armed and self.target is not None:
            wanted = 2.0 * (self.target - self.local()) - 2.4 * self.ekf.v
            wanted = np.clip(wanted, -2.0, 2.0)
        body = turn(self.ekf.yaw).T @ wanted
        self.vehicle.step(t_ns, turn(self.vehicle.yaw) @ body, dt)
        self.ekf.predict(self.clock(t_ns), body, dt)

    def local(self):
        """Its local position (3,), as it tells it and as it is told targets [m, NED]."""
        return self.ekf.p

    def yaw(self):
        """The yaw that it believes in now."""
        return self.ekf.yaw if self.ekf.yaw_aligned and not self.COMPASS else self.compass()

    # streams

    def interval(self, message_id, interval_us):
        """Take a rate; the MAV_RESULT."""
        raise NotImplementedError

    def on_command_long(self, message, t_ns):
        if message.target_system != self.system or message.target_component not in (0, 1):
            return
        result = 3
        if message.command == 511:
            result = self.interval(int(message.param1), message.param2)
        elif message.command == 512:
            result = self.requested(int(message.param1), t_ns)
        self.send(m.MAVLink_command_ack_message(message.command, result))

    def requested(self, message_id, t_ns):
        """Send one message at once; the MAV_RESULT."""
        if message_id == 49 and self.origin is not None:
            self.echo_origin()
            return 0
        return 4

    # parameters

    def on_param_request_read(self, message, t_ns):
        names = sorted(self.params)
        index, name = message.param_index, message.param_id.rstrip("\0")
        if 0 <= index < len(names):
            self.send_param(names[index])
        elif index == -1 and name in self.params:
            self.send_param(name)  # about others it says nothing

    def on_param_request_list(self, message, t_ns):
        for name in sorted(self.params):
            self.send_param(name)

    def on_param_set(self, message, t_ns):
        name = message.param_id.rstrip("\0")
        if name in self.params:
            kind = self.params[name][1]
            self.params[name] = (self.from_wire(message.param_value, kind), kind)
            self.send_param(name)

    def send_param(self, name):
        value, kind = self.params[name]
        index = sorted(self.params).index(name)
        wire = self.to_wire(value, kind)
        self.send(m.MAVLink_param_value_message(name.encode(), wire, kind, len(self.params), index))

    def to_wire(self, value, kind):
        return float(value)

    def from_wire(self, value, kind):
        return value

    def due(self, message_id, t_ns):
        """Whether a stream is due at this true time; it then counts as sent."""
        interval = self.streams.get(message_id)
        if interval is None or t_ns - self.sent_at.get(message_id, 0) < interval:
            return False
        self.sent_at[message_id] = t_ns
        return True

    def imu(self):
        """Gyro and specific force in body FRD of a vehicle that keeps level, a little noisy."""
        noise = self.rng.normal(size=6) * [1e-3, 1e-3, 1e-3, 0.02, 0.02, 0.02]
        return noise[:3], np.array([0.1, -0.2, -9.81]) + noise[3:]

    def attitude(self, t_ns):
        self.send(
            m.MAVLink_attitude_message(
                self.clock(t_ns) // 10**6, 0.0, 0.0, self.yaw(), 0.0, 0.0, 0.0
            )
        )

    def tell_position(self, t_ns):
        if self.due(32, t_ns):
            ms = self.clock(t_ns) // 10**6
            self.send(m.MAVLink_local_position_ned_message(ms, *self.local(), *self.ekf.v))

    def compass(self):
        """The yaw that it believes in before vision."""
        return self.vehicle.yaw

    def echo_origin(self):
        if self.origin is not None:
            self.send(m.MAVLink_gps_global_origin_message(*self.origin, 0))


def own_error(fc):
    """Estimated minus true position now [m]."""
    return float(np.linalg.norm(fc.ekf.p - fc.vehicle.p))
