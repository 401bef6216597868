"""Figures of the house, from the syntax trees of tagvo and vio: how easily it is entered.

One line a figure. `tests/test_architecture.py` holds what of it is a rule; this says where it
stands. No import is made: it runs on any checkout (`python tools/house.py [ROOT]`).
"""

import argparse
import ast
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

PACKAGES = ("tagvo", "vio")
MARKS = ("njit", "bare", "leaf")  # decorators that make a kernel
MOST_ARGUMENTS = 8
LONG_BODY = 40
Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(frozen=True, slots=True)
class Module:
    """A source file: its dotted name, where it lies, and its tree."""

    name: str
    path: Path
    tree: ast.Module
    lines: int


@cache
def modules(root: Path) -> list[Module]:
    """Every module of both packages, by name; read once."""
    found = []
    for path in sorted(p for top in PACKAGES for p in (root / top).rglob("*.py")):
        name = ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")
        text = path.read_text(encoding="utf-8")
        found.append(Module(name, path, ast.parse(text), len(text.splitlines())))
    return found


@cache
def nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """All nodes of a tree, walked once."""
    return tuple(ast.walk(tree))


def imported(module: Module, *, at_top: bool = False) -> tuple[str, ...]:
    """What a module imports, at its top or (unless at_top) within a function."""
    return _imported(module.tree, at_top)


@cache
def _imported(tree: ast.Module, at_top: bool) -> tuple[str, ...]:
    names: list[str] = []
    for node in tree.body if at_top else nodes(tree):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names += (f"{node.module}.{alias.name}" for alias in node.names)
    return tuple(names)


def functions(module: Module) -> Iterator[Function]:
    """All functions and methods of a module."""
    return (n for n in nodes(module.tree) if isinstance(n, Function))


def is_kernel(function: Function) -> bool:
    """Whether a decorator compiles it."""
    return any(
        ast.unparse(d).split("(")[0].split(".")[-1] in MARKS for d in function.decorator_list
    )


def arguments(function: Function) -> int:
    """How many arguments a function takes."""
    a = function.args
    return len(a.posonlyargs) + len(a.args) + len(a.kwonlyargs)


def folders(found: list[Module]) -> dict[str, list[str]]:
    """Entries of each folder: modules without `__init__`, and subfolders."""
    entries: dict[str, set[str]] = defaultdict(set)
    for module in found:
        parent, _, stem = module.name.rpartition(".")
        if module.path.name == "__init__.py":
            if parent:
                entries[parent].add(f"{stem}/")
        else:
            entries[parent].add(stem)
    return {folder: sorted(names) for folder, names in entries.items()}


def users(found: list[Module]) -> Counter[str]:
    """In how many modules each module is imported."""
    known = {module.name for module in found}
    count: Counter[str] = Counter()
    for module in found:
        names = set()
        for name in imported(module):
            while name not in known and "." in name:
                name = name.rpartition(".")[0]
            if name in known and name not in PACKAGES and name != module.name:
                names.add(name)
        count.update(names)
    return count


def body_lines(function: Function) -> int:
    """Lines of a function after its docstring."""
    body = function.body
    first = body[1] if ast.get_docstring(function) and len(body) > 1 else body[0]
    return (function.end_lineno or 0) - first.lineno + 1


def wide_kernels(found: list[Module]) -> list[str]:
    """Kernels with more arguments than a reader can hold."""
    return [
        f"{module.name}.{f.name} ({arguments(f)})"
        for module in found
        for f in functions(module)
        if is_kernel(f) and arguments(f) > MOST_ARGUMENTS
    ]


def wide_groups(found: list[Module]) -> list[str]:
    """Named tuples with more fields than a kernel's argument list may have."""
    groups = [
        (f"{module.name}.{n.name}", sum(isinstance(item, ast.AnnAssign) for item in n.body))
        for module in found
        for n in nodes(module.tree)
        if isinstance(n, ast.ClassDef) and any(ast.unparse(b) == "NamedTuple" for b in n.bases)
    ]
    return [f"{name} ({fields})" for name, fields in groups if fields > MOST_ARGUMENTS]


def component_loops(found: list[Module]) -> Counter[str]:
    """Loops over 3 or 6 components outside `tagvo.kernels`, by module."""
    count: Counter[str] = Counter()
    for module in found:
        if module.name.startswith("tagvo.kernels"):
            continue
        for node in nodes(module.tree):
            if isinstance(node, ast.For) and ast.unparse(node.iter) in ("range(3)", "range(6)"):
                count[module.name] += 1
    return count


def _share(part: int, whole: int) -> str:
    return f"{100.0 * part / max(whole, 1):.1f} % of {whole}"


def main() -> None:
    """Print the figures of a checkout."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).parents[1])
    root = parser.parse_args().root
    found = modules(root)
    by_folder = {k: v for k, v in folders(found).items() if k}
    every = [(module, f) for module in found for f in functions(module)]
    public = [f for _, f in every if not f.name.startswith("_")]
    documented = [f for f in public if ast.get_docstring(f)]
    typed = [
        f for _, f in every
        if f.returns is not None
        and all(a.annotation is not None or a.arg in ("self", "cls") for a in f.args.args)
    ]  # fmt: skip
    inner = {folder: names for folder, names in by_folder.items() if folder not in PACKAGES}
    largest = max(inner.items(), key=lambda item: len(item[1]))
    roots = {p: [n for n in by_folder[p] if not n.endswith("/")] for p in PACKAGES}
    busiest = users(found).most_common(3)
    wide = wide_kernels(found)
    long = [f"{m.name}.{f.name} ({body_lines(f)})" for m, f in every if body_lines(f) > LONG_BODY]
    print(
        f"modules {len(found)} in {len(by_folder)} folders, largest {largest[0]} {len(largest[1])}"
    )
    for package, names in roots.items():
        print(f"root of {package}: {len(names)} ({' '.join(names)})")
    print("fan-in: " + ", ".join(f"{name} {n}" for name, n in busiest))
    print(f"kernels {sum(is_kernel(f) for _, f in every)}, with more than {MOST_ARGUMENTS}"
          f" arguments: {len(wide)}")  # fmt: skip
    for name in wide:
        print(f"  {name}")
    groups, loops = wide_groups(found), component_loops(found)
    print(f"groups with more than {MOST_ARGUMENTS} fields: {len(groups)} {' '.join(groups)}")
    print(f"loops over 3 or 6 outside kernels: {sum(loops.values())} {dict(loops)}")
    print(f"bodies over {LONG_BODY} lines: {len(long)} {' '.join(long)}")
    print(f"docstrings of public functions: {_share(len(documented), len(public))}")
    print(f"annotated: {_share(len(typed), len(every))}")
    print(f"lines of tagvo + vio: {sum(m.lines for m in found)}")


if __name__ == "__main__":
    main()
