"""Reads text, YAML and JSON with errors that name the file; every loader goes through here."""

import json
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

import yaml

from tagvo.errors import TagvoError, shown

_LARGEST = 1e30  # no metre, pixel or second is beyond; powers of what is below stay finite
_DIGITS = 400  # of a whole number: 1e30 written out has 31; str() of thousands raises

try:  # the C parser is ten times faster and comes with the wheels
    from yaml import CSafeLoader as _SafeLoader
except ImportError:  # pragma: no cover - pure-Python PyYAML
    from yaml import SafeLoader as _SafeLoader  # type: ignore[assignment]


class _Loader(_SafeLoader):
    """A safe loader that reads 1e-3 as a number, as YAML 1.2 does; PyYAML alone makes it text."""


def _whole_number(loader: Any, node: Any) -> int:
    if len(node.value) > _DIGITS:
        raise yaml.constructor.ConstructorError(
            None, None, f"a whole number of {len(node.value)} digits", node.start_mark
        )
    return int(loader.construct_yaml_int(node))


_Loader.add_constructor("tag:yaml.org,2002:int", _whole_number)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_text(path: Path, error: type[Exception] = TagvoError, undecodable: str = "strict") -> str:
    """Text of a UTF-8 file; raises `error` naming the file where it cannot be read.

    `undecodable` says what becomes of bytes that are no UTF-8: strict (an error) or replace.
    """
    check_regular(path, error)
    try:
        return path.read_text(encoding="utf-8-sig", errors=undecodable)
    except UnicodeDecodeError as err:
        raise error(f"{path}: not a text file ({err.reason} at byte {err.start})") from None
    except OSError as err:
        raise error(f"{path}: cannot be read ({err.strerror})") from None


@contextmanager
def open_lines(path: Path, error: type[Exception] = TagvoError) -> Iterator[Iterator[str]]:
    """Lines of a UTF-8 file one after the other, for files too long to hold.

    Bytes that are no UTF-8 are replaced; raises `error` naming the file where it cannot be read.
    """
    check_regular(path, error)
    try:
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            yield file
    except OSError as err:
        raise error(f"{path}: cannot be read ({err.strerror})") from None


def check_regular(path: Path, error: type[Exception] = TagvoError) -> None:
    """Raise `error` where no regular file is to be opened: a FIFO would wait, a device never end.

    Links are followed: who laid them meant it.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise error(f"{path}: no such file") from None
    except ValueError:
        raise error(f"{shown(str(path))}: no file has a name with a zero byte") from None
    except OSError as err:
        raise error(f"{path}: cannot be read ({err.strerror})") from None
    if stat.S_ISDIR(mode):
        raise error(f"{path}: is a folder, a file is needed")
    if not stat.S_ISREG(mode):
        raise error(f"{path}: is a FIFO, a device or a socket; a regular file is needed")


def parse_yaml(text: str, where: str, error: type[Exception] = TagvoError) -> Any:
    """YAML value of a text; OpenCV's `%YAML:1.0` first line is accepted."""
    text = re.sub(r"\A%YAML:1\.0[^\n]*\n(---[^\n]*\n)?", "", text)
    text = text.replace("!!opencv-matrix", "")
    try:
        _refuse_aliases(text)
        value = yaml.load(text, Loader=_Loader)  # _Loader is a safe loader
    except yaml.YAMLError as err:
        mark = getattr(err, "problem_mark", None)
        line = f" line {mark.line + 1}" if mark is not None else ""
        reason = getattr(err, "problem", None) or (str(err).splitlines() or ["unreadable"])[0]
        raise error(f"{where}{line}: not valid YAML ({_brief(reason)})") from None
    except _UNBUILDABLE as err:  # a date that is none, a million brackets
        raise error(f"{where}: not valid YAML ({_brief(str(err))})") from None
    return _without_zero_bytes(value, text, where, error)


_UNBUILDABLE = (ValueError, RecursionError, TypeError, AttributeError, OverflowError, KeyError,
                IndexError)  # fmt: skip


def _brief(reason: str) -> str:
    words = " ".join(reason.split())
    return words if len(words) <= 120 else f"{words[:117]}..."


def _refuse_aliases(text: str) -> None:
    """YAMLError for an alias or a tag: the one makes 10^8 values of half a kilobyte, the other
    asks for a type that no file of ours has."""
    if not re.search(r"[&*!]", text):
        return
    for event in yaml.parse(text, Loader=_Loader):
        what = "an alias" if isinstance(event, yaml.AliasEvent) else None
        if getattr(event, "tag", None) not in (None, "!"):
            what = "a tag (!)"
        if what is not None:
            mark: Any = event.start_mark  # of the C parser, whose type is another
            raise yaml.MarkedYAMLError(None, None, f"{what}; plain values are needed", mark)


_ZERO_BYTE = re.compile(r"\0|\\(?:0|x00|u0000|U00000000)")


def _without_zero_bytes(value: Any, text: str, where: str, error: type[Exception]) -> Any:
    """The value; `error` where a text in it holds a zero byte, which no name or path has."""
    if not _ZERO_BYTE.search(text):
        return value
    left = [value]
    while left:
        one = left.pop()
        if isinstance(one, dict):
            left += [*one, *one.values()]
        elif isinstance(one, list | tuple | set):
            left += one
        elif isinstance(one, str) and "\0" in one:
            raise error(f"{where}: {shown(one)} holds a zero byte; plain text is needed")
    return value


def read_yaml(path: Path, error: type[Exception] = TagvoError) -> dict[str, Any]:
    """YAML mapping of a file; raises `error` where it is not YAML or not a mapping."""
    value = parse_yaml(read_text(path, error), str(path), error)
    if not isinstance(value, dict):
        kind = "empty" if value is None else f"a {type(value).__name__}"
        raise error(f"{path}: the file is {kind}; a mapping `key: value` is needed")
    return value


def parse_json(text: str, where: str, error: type[Exception] = TagvoError) -> Any:
    """JSON value of a text; raises `error` where it is none."""
    try:
        value = json.loads(text, parse_int=_json_whole)
    except json.JSONDecodeError as err:
        raise error(f"{where} line {err.lineno}: not valid JSON ({err.msg})") from None
    except (ValueError, RecursionError) as err:
        raise error(f"{where}: not valid JSON ({_brief(str(err))})") from None
    return _without_zero_bytes(value, text, where, error)


def _json_whole(digits: str) -> int:
    if len(digits) > _DIGITS:
        raise ValueError(f"a whole number of {len(digits)} digits")
    return int(digits)


def read_json(path: Path, error: type[Exception] = TagvoError) -> dict[str, Any]:
    """JSON object of a file; raises `error` where it is not JSON or not an object."""
    value = parse_json(read_text(path, error), str(path), error)
    if not isinstance(value, dict):
        raise error(f"{path}: holds a {type(value).__name__}; a JSON object is needed")
    return value


def finite_numbers(value: object, count: int, where: str, error: type[Exception]) -> list[float]:
    """`count` finite numbers of a YAML or JSON list; `error` says what came otherwise."""
    if isinstance(value, list | tuple) and len(value) == count and all(map(is_number, value)):
        return [float(v) for v in value]
    raise error(f"{where}: {shown(value)}; a list of {count} finite numbers is needed")


def finite_number(value: object, where: str, error: type[Exception]) -> float:
    """One finite number of a YAML or JSON file; `error` says what came otherwise."""
    if not is_number(value):
        raise error(f"{where}: {shown(value)}; a finite number is needed")
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
