"""Reads text, YAML and JSON with errors that name the file; every loader goes through here."""

import json
import os
import re
from pathlib import Path
from typing import Any, TypeGuard

import yaml

from tagvo.errors import TagvoError

_LARGEST = 1e30  # no metre, pixel or second is beyond; powers of what is below stay finite

try:  # the C parser is ten times faster and comes with the wheels
    from yaml import CSafeLoader as _SafeLoader
except ImportError:  # pragma: no cover - pure-Python PyYAML
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]


class _Loader(_SafeLoader):
    """A safe loader that reads 1e-3 as a number, as YAML 1.2 does; PyYAML alone makes it text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_text(path: Path, error: type[Exception] = TagvoError, undecodable: str = "strict") -> str:
    """Text of a UTF-8 file; raises `error` naming the file where it cannot be read.

    `undecodable` says what becomes of bytes that are no UTF-8: strict (an error) or replace.
    """
    try:
        return path.read_text(encoding="utf-8-sig", errors=undecodable)
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except IsADirectoryError:
        raise error(f"{path}: is a folder, a file is needed") from None
    except UnicodeDecodeError as err:
        raise error(f"{path}: not a text file ({err.reason} at byte {err.start})") from None
    except OSError as err:
        raise error(f"{path}: cannot be read ({err.strerror})") from None


def parse_yaml(text: str, where: str, error: type[Exception] = TagvoError) -> Any:
    """YAML value of a text; OpenCV's `%YAML:1.0` first line is accepted."""
    text = re.sub(r"\A%YAML:1\.0[^\n]*\n(---[^\n]*\n)?", "", text)
    text = text.replace("!!opencv-matrix", "")
    try:
        return yaml.load(text, Loader=_Loader)  # _Loader is a safe loader
    except yaml.YAMLError as err:
        mark = getattr(err, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark is not None else ""
        reason = getattr(err, "problem", None) or str(err).splitlines()[0]
        raise error(f"{where}{line}: not valid YAML ({reason})") from None
    except (ValueError, RecursionError) as err:  # a date that is none, a million brackets
        raise error(f"{where}: not valid YAML ({err})") from None


def read_yaml(path: Path, error: type[Exception] = TagvoError) -> dict[str, Any]:
    """YAML mapping of a file; raises `error` where it is not YAML or not a mapping."""
    value = parse_yaml(read_text(path, error), str(path), error)
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        raise error(f"{path}: the file is {kind}; a mapping `key: value` is needed")
    return value


def read_json(path: Path, error: type[Exception] = TagvoError) -> dict[str, Any]:
    """JSON object of a file; raises `error` where it is not JSON or not an object."""
    try:
        value = json.loads(read_text(path, error))
    except json.JSONDecodeError as err:
        raise error(f"{path} line {err.lineno}: not valid JSON ({err.msg})") from None
    if not isinstance(value, dict):
        raise error(f"{path}: holds a {type(value).__name__}; a JSON object is needed")
    return value


def finite_numbers(value: object, count: int, where: str, error: type[Exception]) -> list[float]:
    """`count` finite numbers of a YAML or JSON list; `error` says what came otherwise."""
    if isinstance(value, list | tuple) and len(value) == count and all(map(is_number, value)):
        return [float(v) for v in value]
    raise error(f"{where}: {value!r}; a list of {count} finite numbers is needed")


def finite_number(value: object, where: str, error: type[Exception]) -> float:
    """One finite number of a YAML or JSON file; `error` says what came otherwise."""
    if not is_number(value):
        raise error(f"{where}: {value!r}; a finite number is needed")
    return float(value)


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value of YAML or JSON is a finite number; a truth value is none."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) <= _LARGEST  # False for NaN, too


def write_atomic(path: Path, content: str | bytes) -> None:
    """Write a file whole or not at all: a power cut leaves the old file or the new one."""
    data = content.encode() if isinstance(content, str) else content
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
