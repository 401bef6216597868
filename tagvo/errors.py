"""The one family of errors that tagvo raises on purpose: a caller can tell them from bugs."""

import reprlib
from collections.abc import Iterable

_SHOWN_CHARS = 80  # of a value in an error: one line of a terminal holds it


class _Shortened(reprlib.Repr):
    """repr of what a file may hold, in bounded time: six items of a list, three levels."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxlist, self.maxdict, self.maxtuple = 3, 6, 6, 16
        self.maxstring = self.maxother = _SHOWN_CHARS

    def repr_int(self, x: int, level: int) -> str:
        return repr(x) if x.bit_length() < 256 else f"a whole number of {x.bit_length()} bits"


def shown(value: object) -> str:
    """repr of a value that came from outside, at most 80 characters on one line."""
    text = _Shortened().repr(value)
    return text if len(text) <= _SHOWN_CHARS else f"{text[: _SHOWN_CHARS - 3]}..."


def some_of(names: Iterable[object], most: int = 12) -> str:
    """The first names of many, with commas, each shortened; how many more there are."""
    words = [str(name) for name in names]
    listed = [w if len(w) <= _SHOWN_CHARS else f"{w[: _SHOWN_CHARS - 3]}..." for w in words[:most]]
    more = f" and {len(words) - most} more" if len(words) > most else ""
    return ", ".join(listed) + more


class TagvoError(Exception):
    """A known error: its text says where, what came and what is allowed."""


class ConfigError(TagvoError):
    """A configuration value is unknown or out of range."""


class CameraError(TagvoError):
    """A camera file cannot be used."""


class MapError(TagvoError):
    """A tag map cannot be used."""


class DetectorError(TagvoError):
    """A detector library or a tag family is not to be had here."""


def choose_one_of(where: str, came: object, allowed: Iterable[str]) -> str:
    """Text of an error about a name that is not in a table: where, what came, what is allowed."""
    return f"{where}: unknown {shown(came)}; choose one of {', '.join(allowed)}"
