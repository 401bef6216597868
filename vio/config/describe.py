"""The configuration's own words: a commented YAML file and a table of keys, from the models.

Every key says what it means where it is defined (`Field(description=...)`); `configs/arena.yaml`
and the reference in docs/ are written from there (`tools/write_docs.py`).
"""

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import yaml
from pydantic import BaseModel

_HEAD = """\
# Every key that tagvio knows, at its default: a file may leave out all that it does not change.
# Use: tagvio run LOG --out DIR --config FILE, or one key alone: --set tagvo.pose=fused
# (a log's own LOG/config.yaml is taken where no --config is given).
# Written by tools/write_docs.py from the models in tagvo/config.py and vio/config.
"""
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


@dataclass(frozen=True, slots=True)
class Key:
    """A key: dotted name, default as YAML ("" for a section), what is allowed, what it means."""

    name: str
    default: str
    allowed: str
    meaning: str
    section: type[BaseModel] | None = None


def keys(model: type[BaseModel], inside: str = "") -> Iterator[Key]:
    """Every key of a model and of the models in it, in order; a section before its own keys."""
    shapes = model.model_json_schema()["properties"]
    for name, field in model.model_fields.items():
        section, default = _section(field.annotation), _default(field)
        dotted, meaning = f"{inside}{name}", field.description or ""
        written = "needed" if field.is_required() else _value(default)
        if section is None:
            yield Key(dotted, written, _allowed(shapes[name]), meaning)
        elif typing.get_origin(field.annotation) is tuple:
            yield Key(dotted, written, "list of sections", meaning, section)
            yield from keys(section, f"{dotted}[].")
        else:
            optional = type(None) in typing.get_args(field.annotation)
            allowed = "a section or null" if optional else "a section"
            given = "" if isinstance(default, BaseModel) else written
            yield Key(dotted, given, allowed, meaning, section)
            yield from keys(section, f"{dotted}.")


def commented_yaml(model: type[BaseModel], head: str = _HEAD) -> str:
    """A file of every key at its default, with what it means behind it."""
    return head + "".join(f"{line}\n" for line in _lines(model, 0))


def _lines(model: type[BaseModel], depth: int) -> Iterator[str]:
    """A model's lines; sections at a mapping's end are set apart by empty lines."""
    fields = list(model.model_fields.items())
    nested = [isinstance(_default(field), BaseModel) for _, field in fields]
    pad, ends_in_sections = "  " * depth, any(nested) and nested == sorted(nested)
    for (name, field), is_section in zip(fields, nested, strict=True):
        default, meaning = _default(field), field.description or ""
        if is_section:
            if ends_in_sections:
                yield ""
            yield f"{pad}{name}: # {meaning}"
            yield from _lines(type(default), depth + 1)
        elif _is_matrix(default):
            yield f"{pad}{name}: # {meaning}"
            yield from (f"{pad}  - {_value(row)}" for row in default)
        else:
            yield f"{pad}{name}: {_value(default)} # {meaning}"


def _default(field: Any) -> Any:
    return None if field.is_required() else field.get_default(call_default_factory=True)


def _section(annotation: Any) -> type[BaseModel] | None:
    """The model that a field holds, be it optional; None: it is a value."""
    for one in (annotation, *typing.get_args(annotation)):
        if isinstance(one, type) and issubclass(one, BaseModel):
            return one
    return None


def _is_matrix(value: Any) -> bool:
    return isinstance(value, tuple) and any(isinstance(row, tuple) for row in value)


def _value(value: Any) -> str:
    """A default as it stands in a YAML file, on one line."""
    if isinstance(value, BaseModel):
        return ""
    text = yaml.safe_dump(_as_lists(value), default_flow_style=True, width=1000, allow_unicode=True)
    return text.removesuffix("...\n").strip().replace("'", '"')


def _as_lists(value: Any) -> Any:
    return [_as_lists(one) for one in value] if isinstance(value, tuple) else value


def _allowed(shape: dict[str, Any]) -> str:
    """What a key may be, of its JSON schema: words, bounds, or a type."""
    if "anyOf" in shape:
        return " or ".join(_allowed(one) for one in shape["anyOf"])
    if "enum" in shape or "const" in shape:
        return ", ".join(map(str, shape.get("enum", [shape.get("const")])))
    bounds = [f"{sign} {shape[key]:.9g}" for key, sign in _BOUNDS.items() if key in shape]
    if {"minimum", "maximum"} <= set(shape):
        bounds = [f"{shape['minimum']:.9g} to {shape['maximum']:.9g}"]
    if bounds:
        return ", ".join(bounds) + (", whole" if shape["type"] == "integer" else "")
    names = {"null": "null", "boolean": "true, false", "string": "text", "number": "number",
             "integer": "whole number", "array": "list", "object": "mapping"}  # fmt: skip
    return names[shape["type"]]
