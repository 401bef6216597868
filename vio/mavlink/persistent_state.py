"""What must outlive a restart: the reset counter and the signing timestamp, in one small file."""

import json
import logging
from dataclasses import asdict, dataclass
from pathlib import Path

from tagvo.errors import shown
from tagvo.textfile import read_json, write_atomic
from vio.errors import LinkError

_TIMESTAMPS = 1 << 48  # of MAVLink signing: 48 bits
LOG = logging.getLogger("vio.mavlink")


@dataclass(frozen=True, slots=True)
class Saved:
    """reset_counter: the last one that may have been sent, None: no run before; signing_timestamp:
    none above it has been used [10 us since 2015]."""

    reset_counter: int | None = None
    signing_timestamp: int = 0


def load_saved(path: Path) -> Saved:
    """What a run before has left; a file that cannot be used is reported and passed over."""
    try:
        if not path.exists():
            return Saved()
        data = read_json(path, LinkError)
        counter, timestamp = (_whole(data, key) for key in ("reset_counter", "signing_timestamp"))
    except (LinkError, OSError) as err:
        LOG.warning("%s; not usable: the reset counter starts anew", err)
        return Saved()
    return Saved(counter % 256, timestamp if 0 <= timestamp < _TIMESTAMPS else 0)


def _whole(data: dict[str, object], key: str) -> int:
    value = data.get(key)
    if isinstance(value, bool) or not isinstance(value, int):
        raise LinkError(f"{key}: {shown(value)}; a whole number is needed")
    return value


def save(path: Path, saved: Saved) -> bool:
    """Write the file whole or not at all; whether it was written."""
    try:
        write_atomic(path, json.dumps(asdict(saved)) + "\n")
    except OSError as err:
        LOG.warning("%s: cannot be written (%s): after a restart the reset counter may repeat",
                    path, err.strerror)  # fmt: skip
        return False
    return True


def first_counter(saved: Saved, now_ns: int) -> int:
    """A reset counter that the run before has not used; without one, any but the autopilot's 0."""
    if saved.reset_counter is None:
        return 1 + now_ns // 1_000_000 % 255
    return (saved.reset_counter + 1) % 256
