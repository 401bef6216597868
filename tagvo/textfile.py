"""Reads text, YAML and JSON with errors that name the file; every loader goes through here."""

import json
import os
import re
import stat
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeGuard

import yaml

from tagvo.errors import TagvoError, shown

_LARGEST = 1e30  # no metre, pixel or second is beyond; powers of what is below stay finite
_LARGEST_FILE = 32_000_000  # bytes; a map of 10^5 tags with sigmas of their own fills 20 MB
_DIGITS = 400  # of a whole number: 1e30 written out has 31; str() of thousands raises

try:  # the C library is ten times faster to read, twice to write, and comes with the wheels
    from yaml import CSafeDumper as _SafeDumper
    from yaml import CSafeLoader as _SafeLoader
except ImportError:  # pragma: no cover - pure-Python PyYAML
    from yaml import SafeDumper as _SafeDumper  # type: ignore[assignment]
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
_PLAIN_INT = re.compile(r"[-+]?(?:0|[1-9][0-9]{0,17})", re.ASCII)
_PLAIN_FLOAT = re.compile(r"[-+]?[0-9]+\.[0-9]*(?:[eE][-+][0-9]+)?", re.ASCII)
_DEEPEST = 100  # levels of brackets; none of our files has ten
_REMEMBERED = 64  # characters of a plain word that stands more than once, as keys do


class _Builder:
    """Values straight from the parser's events, in one pass: a tree of nodes, as PyYAML makes it,
    costs eight times the time and memory of its values (a map of 10^5 tags: 40 s, 0.8 GB).

    Refused, with their line: aliases (10^8 values of half a kilobyte), tags (types that no file of
    ours has), merge keys, keys that stand twice (the last would win unseen).
    """

    def __init__(self, loader: Any) -> None:
        self._loader = loader
        self._known: dict[str, Any] = {}
        self._open: list[tuple[Any, Any]] = []  # a list or mapping, the event that began it
        self._key: list[Any] = []  # of each open mapping: the key that waits for its value
        self.value: Any = None

    def build(self) -> Any:
        """The value of the one document; YAMLError where there are more, or what is refused."""
        get_event, documents = self._loader.get_event, 0
        while (kind := type(event := get_event())) is not yaml.StreamEndEvent:
            if kind is yaml.ScalarEvent:
                self._take(self._scalar(event), event)
            elif kind is yaml.MappingStartEvent or kind is yaml.SequenceStartEvent:
                self._begin(event)
            elif kind is yaml.MappingEndEvent or kind is yaml.SequenceEndEvent:
                self._key.pop()
                self._take(*self._open.pop())
            elif kind is yaml.AliasEvent:
                raise _refusal("an alias", event)
            elif kind is yaml.DocumentStartEvent:
                documents += 1
                if documents > 1:
                    raise _refusal("a second document", event)
        return self.value

    def _begin(self, event: Any) -> None:
        if event.tag not in (None, "!"):
            raise _refusal("a tag (!)", event)
        if len(self._open) >= _DEEPEST:
            raise _refusal(f"brackets more than {_DEEPEST} deep", event)
        self._open.append(({} if isinstance(event, yaml.MappingStartEvent) else [], event))
        self._key.append(_NO_KEY)

    def _take(self, value: Any, event: Any) -> None:
        """Put a whole value where it belongs."""
        if not self._open:
            self.value = value
            return
        into, key = self._open[-1][0], self._key[-1]
        if isinstance(into, list):
            into.append(value)
        elif key is _NO_KEY:
            if isinstance(value, dict | list):
                raise _refusal("a key that is a list or a mapping", event)
            if value in into:
                raise _refusal(f"the key {shown(value)} twice in one mapping", event)
            self._key[-1] = value
        else:
            into[key] = value
            self._key[-1] = _NO_KEY

    def _scalar(self, event: Any) -> Any:
        text: str = event.value
        if event.implicit[0] and event.tag is None:
            known = self._known.get(text, _NO_KEY)
            if known is not _NO_KEY:
                return known
            if _PLAIN_FLOAT.fullmatch(text):
                return float(text)
            if _PLAIN_INT.fullmatch(text):
                return int(text)
        if event.tag not in (None, "!"):
            raise _refusal("a tag (!)", event)
        tag = self._loader.resolve(yaml.ScalarNode, text, event.implicit)
        if tag == "tag:yaml.org,2002:merge":
            raise _refusal("a merge key (<<)", event)
        node = yaml.ScalarNode(tag, text, event.start_mark, event.end_mark, event.style)
        value = self._loader.construct_object(node)
        self._loader.constructed_objects.clear()
        if event.implicit[0] and event.tag is None and len(text) <= _REMEMBERED:
            self._known[text] = value
        return value


_NO_KEY = object()


def _refusal(what: str, event: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(None, None, f"{what}; plain values are needed", event.start_mark)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+$"), list("-+0123456789")
)


def read_text(path: Path, error: type[Exception] = TagvoError, undecodable: str = "strict") -> str:
    """Text of a UTF-8 file; raises `error` naming the file where it cannot be read.

    `undecodable` says what becomes of bytes that are no UTF-8: strict (an error) or replace.
    """
    check_regular(path, error)
    size = path.stat().st_size
    if size > _LARGEST_FILE:
        raise error(f"{path}: {size / 1e6:.0f} MB; at most {_LARGEST_FILE / 1e6:.0f} MB are read")
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
        loader = _Loader(text)
        try:
            value = _Builder(loader).build()
        finally:
            loader.dispose()
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


def flow_line(value: dict[str, Any]) -> str:
    """A mapping as YAML on one line, its end included, keys in the order given."""
    return str(yaml.dump(value, Dumper=_SafeDumper, default_flow_style=True, sort_keys=False,
                         width=1000))  # fmt: skip


def _brief(reason: str) -> str:
    words = " ".join(reason.split())
    return words if len(words) <= 120 else f"{words[:117]}..."


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
        value = json.loads(text, parse_int=_json_whole, object_pairs_hook=_json_object)
    except json.JSONDecodeError as err:
        raise error(f"{where} line {err.lineno}: not valid JSON ({err.msg})") from None
    except (ValueError, RecursionError) as err:
        raise error(f"{where}: not valid JSON ({_brief(str(err))})") from None
    return _without_zero_bytes(value, text, where, error)


def _json_object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        twice = next(key for key, n in Counter(key for key, _ in pairs).items() if n > 1)
        raise ValueError(f"the key {shown(twice)} stands twice in one object")
    return value


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
