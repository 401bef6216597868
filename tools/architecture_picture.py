"""Draws who imports whom among the folders of tagvo and vio: docs/architecture.svg.

Folders and root modules are those of ORDER in tests/test_architecture.py. An arrow says "imports";
one that a longer way of arrows says as well is left out, and so are those to the foundations that
nearly all import. Layers by longest path, crossings reduced by barycentres (Sugiyama, 1981).
`tools/write_docs.py` writes the file; the same imports give the same bytes.
"""

import ast
import itertools
from collections import defaultdict
from collections.abc import Callable
from functools import cache
from pathlib import Path

import house

FOUNDATIONS = ("errors", "geometry", "textfile", "records", "config", "interrupt", "terminal")
BOX, GAP, LANE, HEIGHT, ROW, MARGIN = 104, 14, 16, 30, 66, 24  # [px]
TITLE, SWEEPS = 46, 24
COLOURS = {"tagvo": ("#e3f0ea", "#2e7d5b"), "vio": ("#e5ebf7", "#345a9c")}  # fill, stroke
Item = str | tuple[str, str, int]  # a folder, or an arrow's place in a row that it passes


def order(root: Path) -> list[str]:
    """The folders from the bottom up, as the architecture test has them."""
    tree = ast.parse((root / "tests/test_architecture.py").read_text(encoding="utf-8"))
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "ORDER":
            return list(ast.literal_eval(node.value))
    raise SystemExit("tests/test_architecture.py: no ORDER; a tuple of folders is needed")


def unit(module: str) -> str:
    """The folder or root module of a name."""
    return ".".join(module.split(".")[:2])


def dependencies(found: list[house.Module]) -> dict[str, set[str]]:
    """Which folders each folder imports."""
    needs: dict[str, set[str]] = defaultdict(set)
    for module in found:
        for name in house.imported(module):
            here, there = unit(module.name), unit(name)
            if "." in here and name.startswith(("tagvo.", "vio.")) and there != here:
                needs[here].add(there)
    return needs


def reduced(needs: dict[str, set[str]]) -> dict[str, set[str]]:
    """The same without arrows that a longer way says as well."""

    @cache
    def reached(name: str) -> set[str]:
        below = needs.get(name, set())
        return below.union(*(reached(one) for one in below))

    return {
        name: {n for n in below if not any(n in reached(m) for m in below - {n})}
        for name, below in needs.items()
    }


class Layers:
    """Folders in rows, each above all that it imports; arrows pass the rows between in lanes."""

    def __init__(self, names: list[str], needs: dict[str, set[str]]) -> None:
        self.row = dict.fromkeys(names, 0)
        for name in names:  # from the bottom up
            floor = max((self.row[n] for n in names if n.startswith("tagvo.")), default=0)
            below = [self.row[n] for n in needs[name]]
            if name.startswith("vio.") and not any(n.startswith("vio.") for n in needs[name]):
                below.append(floor)
            self.row[name] = max(below, default=-1) + 1
        self.rows: list[list[Item]] = [[] for _ in range(max(self.row.values()) + 1)]
        for name in names:
            self.rows[self.row[name]].append(name)
        self.paths: list[list[Item]] = []
        for name in names:
            for lower in sorted(needs[name], key=names.index):
                inner: list[Item] = [
                    (name, lower, r) for r in range(self.row[name] - 1, self.row[lower], -1)
                ]
                for item, r in zip(inner, range(self.row[name] - 1, 0, -1), strict=False):
                    self.rows[r].append(item)
                self.paths.append([name, *inner, lower])
        self._near: dict[Item, list[Item]] = defaultdict(list)
        for path in self.paths:
            for a, b in itertools.pairwise(path):
                self._near[a].append(b)
                self._near[b].append(a)
        self._untangle()
        self.x = self._places()

    def at(self, item: Item) -> int:
        """The row of a folder, or of an arrow's lane."""
        return self.row[item] if isinstance(item, str) else item[2]

    def _crossings(self) -> int:
        place = {item: i for row in self.rows for i, item in enumerate(row)}
        count = 0
        for r in range(len(self.rows) - 1):
            ends = sorted(
                (place[a], place[b])
                for a in self.rows[r + 1]
                for b in self._near[a]
                if self.at(b) == r
            )
            count += sum(
                1 for i, (a, b) in enumerate(ends) for c, d in ends[i + 1 :] if a < c and b > d
            )
        return count

    def _untangle(self) -> None:
        best, least = [list(row) for row in self.rows], self._crossings()
        for sweep in range(SWEEPS):
            up = sweep % 2 == 0
            turns = range(1, len(self.rows)) if up else range(len(self.rows) - 2, -1, -1)
            for r in turns:
                other = {item: i for i, item in enumerate(self.rows[r - 1 if up else r + 1])}
                here = {item: i for i, item in enumerate(self.rows[r])}
                share = max(len(other), 1) / max(len(here), 1)

                def wanted(item: Item, other=other, here=here, share=share) -> float:
                    near = [other[n] for n in self._near[item] if n in other]
                    return sum(near) / len(near) if near else here[item] * share

                self.rows[r].sort(key=wanted)
            if self._crossings() < least:
                best, least = [list(row) for row in self.rows], self._crossings()
        self.rows = best

    def _places(self) -> dict[Item, float]:
        """Middle of each item along its row [px]: near what it is tied to, without overlap."""
        x: dict[Item, float] = {}
        for row in self.rows:
            at = 0.0
            for item in row:
                x[item] = at + _width(item) / 2
                at += _width(item) + GAP
            for item in row:
                x[item] -= at / 2
        for _ in range(SWEEPS):
            for row in self.rows:
                aims = [sum(x[n] for n in self._near[i]) / max(len(self._near[i]), 1) for i in row]
                placed: list[float] = []
                for item, aim in zip(row, aims, strict=True):
                    if placed:
                        last = row[len(placed) - 1]
                        aim = max(aim, placed[-1] + (_width(last) + _width(item)) / 2 + GAP)
                    placed.append(aim)
                shift = sum(a - p for a, p in zip(aims, placed, strict=True)) / max(len(row), 1)
                x.update({item: p + shift for item, p in zip(row, placed, strict=True)})
        least = min(x[i] - _width(i) / 2 for i in x)
        return {item: at - least + MARGIN for item, at in x.items()}


def _width(item: Item) -> int:
    return BOX if isinstance(item, str) else LANE


def svg(root: Path) -> str:
    """The picture of a checkout, as the text of an SVG file."""
    units = order(root)
    drawn = [name for name in units if name.split(".")[1] not in FOUNDATIONS]
    needs = dependencies(house.modules(root))
    kept = {name: {n for n in needs[name] if n in drawn} for name in drawn}
    layers = Layers(drawn, reduced(kept))
    width = max(layers.x[n] + BOX / 2 for n in drawn) + MARGIN
    first_vio = min(layers.row[n] for n in drawn if n.startswith("vio."))
    count = len(layers.rows)
    bottom = TITLE + (count + 2) * ROW

    def y(row: float) -> float:
        """Middle of a row; vio's rows stand above the line of its foundations."""
        return bottom - ROW * (1.5 + row + (1 if row >= first_vio else 0))

    parts = [_arrow(path, layers, y) for path in layers.paths]
    parts += [_box(name, layers.x[name], y(layers.row[name])) for name in drawn]
    for package, at in (("tagvo", bottom - 0.5 * ROW), ("vio", bottom - (1.5 + first_vio) * ROW)):
        names = [n.split(".")[1] for n in units if n not in drawn and n.startswith(f"{package}.")]
        parts.append(_foundation(package, names, at, width))
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:.0f} {bottom:.0f}"'
        f' width="{width:.0f}" height="{bottom:.0f}" font-family="sans-serif" font-size="13">\n'
        "<title>Who imports whom among the folders of tagvo and vio</title>\n"
        f'<rect width="{width:.0f}" height="{bottom:.0f}" fill="#ffffff"/>\n'
        f'<text x="{MARGIN}" y="26" fill="#444444">An arrow: imports. What a longer way of arrows'
        " says, and imports of the two bars, are left out.</text>\n"
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7"'
        ' markerHeight="7" orient="auto"><path d="M0 0 L8 4 L0 8 z" fill="#777777"/></marker>'
        "</defs>\n"
    )
    return head + "\n".join(parts) + "\n</svg>\n"


def _arrow(path: list[Item], layers: Layers, y: Callable[[float], float]) -> str:
    """A curve from a folder down to one that it imports, upright where it passes other boxes."""
    half = HEIGHT / 2
    text, x = f"M{layers.x[path[0]]:.0f} {y(layers.at(path[0])) + half:.0f}", layers.x[path[0]]
    above = y(layers.at(path[0])) + half
    for item in path[1:]:
        to, below = layers.x[item], y(layers.at(item)) - half - (item == path[-1])
        middle = (above + below) / 2
        text += f" C{x:.0f} {middle:.0f} {to:.0f} {middle:.0f} {to:.0f} {below:.0f}"
        x, above = to, below + HEIGHT
        if item != path[-1]:
            text += f" V{above:.0f}"
    return f'<path d="{text}" fill="none" stroke="#999999" marker-end="url(#tip)"/>'


def _box(name: str, x: float, y: float) -> str:
    package, stem = name.split(".")
    fill, stroke = COLOURS[package]
    return (
        f'<rect x="{x - BOX / 2:.0f}" y="{y - HEIGHT / 2:.0f}" width="{BOX}" height="{HEIGHT}"'
        f' rx="5" fill="{fill}" stroke="{stroke}"/>'
        f'<text x="{x:.0f}" y="{y + 4:.0f}" text-anchor="middle">{stem}</text>'
    )


def _foundation(package: str, names: list[str], y: float, width: float) -> str:
    fill, stroke = COLOURS[package]
    return (
        f'<rect x="{MARGIN}" y="{y - HEIGHT / 2:.0f}" width="{width - 2 * MARGIN:.0f}"'
        f' height="{HEIGHT}" rx="5" fill="{fill}" stroke="{stroke}" stroke-dasharray="4 3"/>'
        f'<text x="{MARGIN + 12}" y="{y + 4:.0f}"><tspan font-weight="bold">{package}</tspan>'
        f" for all above it: {', '.join(names)}</text>"
    )


if __name__ == "__main__":
    print(svg(Path(__file__).parents[1]), end="")
