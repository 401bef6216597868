"""The one family of errors that tagvo raises on purpose: a caller can tell them from bugs."""

from collections.abc import Iterable


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
    return f"{where}: unknown {came!r}; choose one of {', '.join(allowed)}"
