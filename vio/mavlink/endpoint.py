"""Where the flight controller is: the text of `mavlink.url`, taken apart and checked."""

import re
from dataclasses import dataclass

from vio.config.mavlink import MavlinkConfig
from vio.errors import LinkError

FORMS = "udpin:HOST:PORT (listen), udpout:HOST:PORT (call), tcp:HOST:PORT or serial:/dev/NAME:BAUD"
_SCHEMES = {"udpin": "udpin", "udp": "udpin", "udpout": "udpout", "tcp": "tcp", "tcpout": "tcp"}
_USUAL_BAUD = 921600
_HIGHRES_BYTES = {"HIGHRES_IMU": 74, "RAW_IMU": 41, "SCALED_IMU": 36, "SCALED_IMU2": 36,
                  "SCALED_IMU3": 36, "none": 0}  # fmt: skip
_SIGNATURE = 13
_OTHERS = 3000  # bytes a second of all else that an autopilot sends
_SPARE = 1.25  # PX4 sends its IMU's own 250 Hz where 200 are needed


@dataclass(frozen=True, slots=True)
class Address:
    """kind: udpin, udpout, tcp or serial; place: host or device; number: port or baud."""

    kind: str
    place: str
    number: int


def parse_url(url: str) -> Address:
    """The parts of a link's URL; LinkError says what is allowed."""
    text = url.strip().replace("://", ":", 1)
    if text.startswith(("serial:", "/dev/")):
        return _serial(url, text.removeprefix("serial:"))
    scheme, _, rest = text.partition(":")
    host, colon, port = rest.rpartition(":")
    if scheme not in _SCHEMES or not colon:
        raise LinkError(f"mavlink.url {url!r}: {FORMS} is needed")
    if not port.isascii() or not port.isdigit() or not 0 < int(port) < 65536:
        raise LinkError(f"mavlink.url {url!r}: port {port!r}; a number from 1 to 65535 is needed")
    kind = _SCHEMES[scheme]
    if not host and kind != "udpin":
        raise LinkError(f"mavlink.url {url!r}: has no host; {FORMS} is needed")
    return Address(kind, host or "0.0.0.0", int(port))


def _serial(url: str, rest: str) -> Address:
    path, _, baud = (re.sub(r",(?=\d*$)", ":", rest)).partition(":")
    if not path.startswith("/"):
        raise LinkError(
            f"mavlink.url {url!r}: {path!r} is no device; serial:/dev/NAME:BAUD is needed"
        )
    if baud and not (baud.isascii() and baud.isdigit() and int(baud) > 0):
        raise LinkError(f"mavlink.url {url!r}: baud rate {baud!r}; a number is needed")
    return Address("serial", path, int(baud or _USUAL_BAUD))


def needed_baud(config: MavlinkConfig) -> int:
    """The bits a second that the autopilot's messages need on a serial line (8N1)."""
    size = _HIGHRES_BYTES[config.imu.message]
    size += _SIGNATURE if size and config.signing is not None else 0
    return round(10 * (size * config.imu.rate_hz * _SPARE + _OTHERS))


def check_baud(address: Address, config: MavlinkConfig) -> None:
    """Raises LinkError where a serial line cannot carry the IMU stream that is asked for."""
    needed = needed_baud(config)
    if address.kind != "serial" or address.number >= needed:
        return
    usual = next((b for b in (57600, 115200, 230400, 460800, 921600) if b >= needed), needed)
    raise LinkError(
        f"mavlink.url serial:{address.place}:{address.number}: {address.number} baud cannot carry"
        f" {config.imu.message} at {config.imu.rate_hz:g} Hz, which needs {needed};"
        f" use {usual} or more (921600 is usual), here and in the autopilot"
    )
