"""The simulator's end of PX4's MAVLink interface: HIL_SENSOR out, HIL_ACTUATOR_CONTROLS in.

Written from PX4's user guide (simulation, lock step): PX4 connects to the simulator by TCP on port
4560. Its clock is that of HIL_SENSOR; until its first answer it runs free, then each step waits.
"""

import select
import socket
from collections import Counter
from typing import Any

import numpy as np

from tagvo import geometry as geo
from tagvo.geometry import Array
from vio.config.mavlink import OriginConfig
from vio.errors import LinkError
from vio.mavlink.codec import Codec
from vio.mavlink.messages import Outgoing
from vio.sitl.records import SimState

PORT = 4560
PERIOD_NS = 4_000_000  # 250 Hz, as its other simulators do
_START_US = 1_000_000  # of its clock: 0 means no time
_FREE_S, _PATIENCE_S = 0.004, 1.0  # while it starts it runs in about real time
_MOST_UNANSWERED = 20
_GPS_NS, _TRUTH_NS = 200_000_000, 20_000_000
_MAG_N = np.array([0.21, 0.01, 0.43])  # [gauss]
_EARTH_M = 6_378_137.0
_ALL_SENSORS = 0x1FFF
_NOISE = {"mag": 1e-3, "hPa": 0.02}  # PX4 takes a sensor that never changes for a stuck one
_LOCKSTEP = 1


class Px4End:
    """`make px4_sitl none_iris` calls; `controls` is what it wants of its motors."""

    def __init__(
        self,
        rng: np.random.Generator,
        host: str = "127.0.0.1",
        port: int = PORT,
        origin: OriginConfig | None = None,
        gps: bool = False,
        patience_s: float = 60.0,
    ) -> None:
        """rng: noise of barometer and magnetometer; gps: send HIL_GPS, too; patience_s: how long to
        wait for PX4 to connect. Raises LinkError where the port is in use."""
        self.counters: Counter[str] = Counter()
        self.controls: tuple[float, ...] = ()
        self._rng, self._origin, self._gps = rng, origin or OriginConfig(), gps
        self._where = f"tcp:{host}:{port}"
        try:
            self._listener = socket.create_server((host, port))
        except OSError as err:
            raise LinkError(
                f"SITL port {host}:{port}: {err.strerror}; another simulator may run"
            ) from None
        self._listener.settimeout(patience_s)
        self._socket: socket.socket | None = None
        self._codec = Codec(1, 51)
        self._locked = self._same_clock = False
        self._unanswered = 0
        self._gps_ns = self._truth_ns = -_GPS_NS

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return int(self._listener.getsockname()[1])

    @property
    def period_ns(self) -> int:
        """250 Hz."""
        return PERIOD_NS

    def start(self) -> None:
        """Wait for PX4 to connect."""
        try:
            self._socket, _ = self._listener.accept()
        except TimeoutError:
            raise LinkError(
                f"{self._where}: no PX4 SITL connects; start it with: make px4_sitl none_iris"
            ) from None
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._codec = Codec(1, 51)
        self._locked, self._unanswered = False, 0

    def step(self, state: SimState) -> bool:
        """Send the sensors of a step and wait for the answer; False: it has connected anew."""
        assert self._socket is not None
        try:
            self._socket.sendall(b"".join(self._codec.encode(m) for m in self._messages(state)))
            self._wait(_time_us(state))
        except (ConnectionError, BrokenPipeError):
            self.counters["restarts"] += 1
            self._socket.close()
            self.start()
            return False
        return True

    def stop(self) -> None:
        """Give sockets back."""
        for one in (self._socket, self._listener):
            if one is not None:
                one.close()

    def _messages(self, state: SimState) -> list[Outgoing]:
        out = [hil_sensor(state, self._rng, self._origin.alt_m)]
        if state.t_ns - self._truth_ns >= _TRUTH_NS:
            self._truth_ns = state.t_ns
            out.append(hil_state(state, self._origin))
        if self._gps and state.t_ns - self._gps_ns >= _GPS_NS:
            self._gps_ns = state.t_ns
            out.append(hil_gps(state, self._origin))
        return out

    def _wait(self, sent_us: int) -> None:
        """Until PX4 has answered this step; while it starts, no longer than the step lasts."""
        assert self._socket is not None
        while True:
            patience = _PATIENCE_S if self._locked else _FREE_S
            if not select.select([self._socket], [], [], patience)[0]:
                self._missed()
                return
            data = self._socket.recv(65536)
            if not data:
                raise ConnectionResetError
            answers = [self._taken(m, sent_us) for m in self._codec.decode(data)]
            if any(answers):
                self._unanswered = 0
                return

    def _missed(self) -> None:
        if not self._locked:
            self.counters["free_steps"] += 1
            return
        self.counters["unanswered"] += 1
        self._unanswered += 1
        if self._unanswered > _MOST_UNANSWERED:
            raise LinkError(f"{self._where}: PX4 has not answered for {self._unanswered} s")

    def _taken(self, message: Any, sent_us: int) -> bool:
        """Whether this message answers the step that was sent."""
        if message.get_type() != "HIL_ACTUATOR_CONTROLS":
            return False
        self.controls = tuple(message.controls)
        if not self._locked:
            self._locked = bool(message.flags & _LOCKSTEP)
            self._same_clock = abs(message.time_usec - sent_us) < 1_000_000
        # an answer to an earlier step does not free this one
        return not self._same_clock or message.time_usec >= sent_us


def _time_us(state: SimState) -> int:
    return state.t_ns // 1000 + _START_US


def hil_sensor(state: SimState, rng: np.random.Generator, alt_m: float) -> Outgoing:
    """HIL_SENSOR: the IMU as it is, magnetometer and barometer from the reference motion."""
    mag = geo.matrix_from_quat(state.q_NF).T @ _MAG_N + _NOISE["mag"] * rng.normal(size=3)
    height = alt_m - state.p_N[2]
    pressure = 1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588 + _NOISE["hPa"] * rng.normal()
    fields: dict[str, Any] = {"time_usec": _time_us(state)}
    for name, vector in (("acc", state.accel_F), ("gyro", state.gyro_F), ("mag", mag)):
        fields |= _axes(name, vector)
    fields |= {"abs_pressure": pressure, "diff_pressure": 0.0, "pressure_alt": height}
    return Outgoing("HIL_SENSOR", fields | {"temperature": 25.0, "fields_updated": _ALL_SENSORS})


def _axes(name: str, vector: Array) -> dict[str, float]:
    return {f"{axis}{name}": float(v) for axis, v in zip("xyz", vector, strict=True)}


def _on_earth(state: SimState, origin: OriginConfig) -> dict[str, int]:
    """Latitude and longitude [1e-7 deg], altitude [mm]."""
    north, east = np.degrees(state.p_N[:2] / _EARTH_M)
    return {
        "lat": round((origin.lat_deg + north) * 1e7),
        "lon": round((origin.lon_deg + east / np.cos(np.radians(origin.lat_deg))) * 1e7),
        "alt": round((origin.alt_m - state.p_N[2]) * 1e3),
    }


def hil_gps(state: SimState, origin: OriginConfig) -> Outgoing:
    """HIL_GPS: a good fix at the reference motion."""
    vn, ve, vd = (round(v * 100) for v in state.v_N.tolist())
    speed = float(np.hypot(state.v_N[0], state.v_N[1]))
    course = np.degrees(np.arctan2(state.v_N[1], state.v_N[0])) % 360.0
    fields = {"time_usec": _time_us(state), "fix_type": 3, **_on_earth(state, origin)}
    fields |= {"eph": 30, "epv": 40, "vel": round(speed * 100), "vn": vn, "ve": ve, "vd": vd}
    return Outgoing("HIL_GPS", fields | {"cog": round(course * 100), "satellites_visible": 12})


def hil_state(state: SimState, origin: OriginConfig) -> Outgoing:
    """HIL_STATE_QUATERNION: the reference motion, for PX4's own log."""
    v = [round(x * 100) for x in state.v_N.tolist()]
    a = [round(x / 9.80665e-3) for x in state.accel_F.tolist()]
    roll, pitch, yaw = state.gyro_F.tolist()
    fields = {"time_usec": _time_us(state), "attitude_quaternion": state.q_NF.tolist()}
    fields |= {"rollspeed": roll, "pitchspeed": pitch, "yawspeed": yaw}
    fields |= {**_on_earth(state, origin), "vx": v[0], "vy": v[1], "vz": v[2]}
    fields |= {"ind_airspeed": 0, "true_airspeed": 0}
    return Outgoing("HIL_STATE_QUATERNION", fields | {"xacc": a[0], "yacc": a[1], "zacc": a[2]})
