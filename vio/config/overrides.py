"""`--set a.b=c`: single settings on top of a file, the same way in every command that has files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tagvo.errors import ConfigError
from tagvo.textfile import parse_yaml


def assign(data: dict[str, Any], text: str, example: str = "tagvo.pose=fused") -> None:
    """Put the YAML value of `a.b=value` at its place in nested mappings."""
    keys, equals, value = text.partition("=")
    path = [key.strip() for key in keys.split(".")]
    if not equals or not all(path):
        raise ConfigError(f"--set {text}: KEY.KEY=VALUE is needed, such as {example}")
    here = data
    for key in path[:-1]:
        inner = here.get(key)
        here[key] = inner = dict(inner) if isinstance(inner, dict) else {}
        here = inner
    here[path[-1]] = parse_yaml(value, f"--set {text}", ConfigError)


def origin(path: Path | None, assignments: Sequence[str], nothing: str = "configuration") -> str:
    """Where values came from, for errors: the file and the assignments."""
    sources = [str(path)] if path is not None else []
    sources += [f"--set {text}" for text in assignments]
    return ", ".join(sources) or nothing
