"""Writes what the documentation takes from the code: tables, the picture, configs/arena.yaml.

    python tools/write_docs.py           write what has changed
    python tools/write_docs.py --check   name what has changed, write nothing, exit code 1

A page keeps its text; only what stands between `<!-- generated: NAME -->` and `<!-- end -->` is
written anew. The same code gives the same bytes; `tests/test_docs.py` holds it.
"""

import ast
import re
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import architecture_picture as picture
import house

if TYPE_CHECKING:
    from pydantic import BaseModel

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table; what stands in cells may hold bars."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(str(c).replace('|', '&#124;') for c in r)} |\n" for r in lines)


def folders() -> str:
    """What each folder or root module holds, in the order of the imports."""
    units = picture.order(ROOT)
    found = {module.name: module for module in house.modules(ROOT)}
    needs = picture.reduced(picture.dependencies(list(found.values())))
    rows = []
    for name in units:
        below = [n for n in units if n in needs.get(name, set())]
        text = (ast.get_docstring(found[name].tree) or "").split("\n")[0].rstrip(".")
        rows.append([f"`{name}`", text, ", ".join(f"`{n}`" for n in below) or "-"])
    return table(["folder or module", "what it holds", "builds on"], rows)


def configuration() -> str:
    """Every configuration key, section by section."""
    from vio.config import Config

    return _sections(Config)


def scenario() -> str:
    """Every key of a scenario, section by section."""
    from vio.sim.scenario import Scenario

    return _sections(Scenario)


def _sections(model: "type[BaseModel]") -> str:
    from vio.config.describe import keys

    out: list[str] = []
    rows: list[list[str]] = []
    for key in keys(model):
        default = f"`{key.default}`" if key.default else ""
        if key.section is None:
            rows.append([f"`{key.name}`", default, key.allowed, key.meaning])
            continue
        out, rows = [*out, *_key_table(rows)], []
        level = "#" * min(2 + key.name.count("."), 4)
        kind = "" if key.allowed == "a section" else f" ({key.allowed})"
        out.append(f"\n{level} `{key.name}`\n\n{_sentence(key.meaning)}{kind}\n")
        more = (key.section.__doc__ or "").strip().split("\n\n", 1)[1:]
        out += [f"\n{' '.join(text.split())}\n" for text in more]
    return "".join([*out, *_key_table(rows)])


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _key_table(rows: list[list[str]]) -> list[str]:
    return ["\n", table(["key", "default", "allowed", "meaning"], rows)] if rows else []


def state() -> str:
    """The filter's state, block by block."""
    from vio.config.filter import PriorConfig
    from vio.filter.state import BLOCKS

    rows, at = [], 0
    for b in BLOCKS:
        span = f"{at} to {at + b.error - 1}" if b.error > 1 else f"{at}"
        prior = f"`{b.prior}`" if b.prior in PriorConfig.model_fields else f"{b.prior}"
        switch = f"`vio.{b.switch}`" if b.switch else "always"
        rows.append([f"`{b.name}`", span, str(b.nominal), b.unit, b.sense, prior, switch])
        at += b.error
    head = ["block", "rows", "numbers", "unit", "what it is", "prior", "switch"]
    return table(head, rows)


def api(package: str) -> str:
    """A directive for each public name of a package, in groups by where they stand."""
    homes = __import__(package)._HOME
    return "".join(f"\n::: {package}.{homes[name]}.{name}\n" for name in sorted(homes))


PARTS: dict[str, tuple[str, Callable[[], str]]] = {
    "docs/architecture.md": ("folders", folders),
    "docs/reference/configuration.md": ("keys", configuration),
    "docs/reference/scenario.md": ("keys", scenario),
    "docs/filter/state.md": ("state", state),
    "docs/reference/tagvo.md": ("api", lambda: api("tagvo")),
    "docs/reference/vio.md": ("api", lambda: api("vio")),
}


def filled(text: str, name: str, content: str, where: str) -> str:
    """A page with its generated part replaced."""
    pattern = rf"(<!-- generated: {name} -->\n).*?(<!-- end -->)"
    if not re.search(pattern, text, re.DOTALL):
        raise SystemExit(f"{where}: no `<!-- generated: {name} -->` with `<!-- end -->` after it")
    return re.sub(pattern, lambda m: f"{m[1]}{content}{m[2]}", text, flags=re.DOTALL)


def arena() -> str:
    """The file of all keys."""
    from vio.config import Config
    from vio.config.describe import commented_yaml

    return commented_yaml(Config)


def files() -> dict[str, Callable[[], str]]:
    """What is written, by path: a function that gives its whole text."""

    def page(path: str, name: str, content: Callable[[], str]) -> Callable[[], str]:
        return lambda: filled((ROOT / path).read_text(encoding="utf-8"), name, content(), path)

    out: dict[str, Callable[[], str]] = {path: page(path, *part) for path, part in PARTS.items()}
    out["configs/arena.yaml"] = arena
    out["docs/architecture.svg"] = lambda: picture.svg(ROOT)
    return out


def main() -> int:
    """Write, or only check; the number of files that had changed decides the exit code."""
    check, stale = "--check" in sys.argv[1:], []
    for path, text in files().items():
        target, new = ROOT / path, text()
        if not target.exists() or target.read_text(encoding="utf-8") != new:
            stale.append(path)
            if not check:
                target.write_text(new, encoding="utf-8")
    for path in stale:
        print(f"{path}: {'is not what the code says' if check else 'written'}")
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
