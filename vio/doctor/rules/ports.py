"""Rules on the autopilot's ports: protocol, mode and baud rate of the one that we are on."""

from vio.doctor.records import Change, Facts, Finding, Severity
from vio.doctor.rules import ardupilot_parameters, px4_parameters
from vio.mavlink.endpoint import needed_baud, parse_url
from vio.mavlink.messages import ARDUPILOT

E, W, I = Severity.ERROR, Severity.WARNING, Severity.INFO  # noqa: E741
_MAVLINK = (1, 2)  # SERIALn_PROTOCOL


def check(f: Facts) -> list[Finding]:
    """What is wrong with the port of a serial link; by UDP and TCP it is not known which it is."""
    address = parse_url(f.config.url)
    if address.kind != "serial":
        return []
    return _ardupilot(f, address.number) if f.autopilot == ARDUPILOT else _px4(f, address.number)


def _ardupilot(f: Facts, baud: int) -> list[Finding]:
    p = f.params
    here = [
        n
        for n in ardupilot_parameters.PORTS
        if p.get(f"SERIAL{n}_PROTOCOL") in _MAVLINK
        and ardupilot_parameters.baud(p.get(f"SERIAL{n}_BAUD", 0.0)) == baud
    ]
    out = []
    if here and all(p[f"SERIAL{n}_PROTOCOL"] == 1 for n in here):
        name = f"SERIAL{here[0]}_PROTOCOL"
        change = Change(name, 1.0, 2.0) if len(here) == 1 else None
        out.append(
            Finding(
                E,
                name,
                f"{name} is 1",
                "MAVLink 1 has neither covariance nor reset counter",
                f"set {name} 2",
                change,
            )
        )
    return out + _too_slow(f, baud)


def _px4(f: Facts, baud: int) -> list[Finding]:
    p = f.params
    out = []
    for n in px4_parameters.INSTANCES:
        device = px4_parameters.DEVICES.get(round(p.get(f"MAV_{n}_CONFIG", 0.0)))
        if device is None or p.get(device) != baud:
            continue
        needed = needed_baud(f.config) / 10.0
        rate, name = p.get(f"MAV_{n}_RATE", 0.0), f"MAV_{n}_RATE"
        if 0.0 < rate < needed:
            out.append(
                Finding(
                    W,
                    name,
                    f"{name} is {rate:g} bytes a second",
                    f"the IMU needs {needed:.0f}: PX4 slows all streams to fit",
                    f"set {name} 80000",
                    Change(name, rate, 80000.0),
                )
            )
    return out + _too_slow(f, baud)


def _too_slow(f: Facts, baud: int) -> list[Finding]:
    needed = needed_baud(f.config)
    if baud >= needed:
        return []
    what = f"{f.config.imu.message} at {f.config.imu.rate_hz:g} Hz"
    return [
        Finding(
            E,
            "baud",
            f"{baud} baud cannot carry {what}",
            f"that needs {needed} bits a second; samples get lost and late",
            "921600 on both sides",
        )
    ]
