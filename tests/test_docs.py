"""The documentation is what the code says: generated parts, links, files it names, frames, math."""

import ast
import re
from pathlib import Path

import architecture_picture as picture
import house
import pytest
import write_docs
from doc_pages import PAGES, ROOT, text_of

DOCS = ROOT / "docs"
MODULES = sorted(p for top in ("tagvo", "vio") for p in (ROOT / top).rglob("*.py"))


@pytest.mark.parametrize("path", write_docs.files())
def test_what_is_written_from_the_code_is_up_to_date(path):
    written = (ROOT / path).read_text(encoding="utf-8")
    assert written == write_docs.files()[path](), f"{path}: run tools/write_docs.py"


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub and mkdocs make it of plain words."""
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page):
    wrong = []
    for link in re.findall(r"\]\((?!https?:)([^)\s]+)\)", text_of(page)):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        if not target.exists():
            wrong.append(link)
        elif anchor:
            heads = re.findall(r"^#+ (.*)$", text_of(target), re.MULTILINE)
            wrong += [] if anchor in map(slug, heads) else [link]
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_files_that_a_page_names_exist(page):
    named = re.findall(r"`((?:tools|configs|tests|docs|tagvo|vio)/[\w./-]+)`", text_of(page))
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_keys_that_pages_name_exist():
    from vio.config import Config
    from vio.config.describe import keys
    from vio.sim.scenario import Scenario

    known = {key.name for model in (Config, Scenario) for key in keys(model)}
    sections = tuple(Config.model_fields)
    named = {
        name
        for page in PAGES
        for name in re.findall(rf"`((?:{'|'.join(sections)})\.[a-z_][\w.]*)`", text_of(page))
    }
    assert len(named) > 100
    modules = {".".join(p.relative_to(ROOT).with_suffix("").parts) for p in MODULES}
    modules |= {m.removesuffix(".__init__") for m in modules} | {"vio.tum", "tagvo.detect.Detector"}
    assert sorted(named - known - modules) == []


def test_values_of_the_short_table_of_keys_are_taken():
    from vio.config import load_config

    text = text_of(DOCS / "reference/configuration.md").split("<!-- generated")[0]
    rows = re.findall(r"^\| `((?:tagvo|vio)\.[\w.]+)` \| ([^|]+) \|", text, re.MULTILINE)
    assert len(rows) >= 12
    for key, values in rows:
        for value in re.findall(r"`([\w.]+)`", values):
            load_config(None, [f"{key}={value}"])


def rows_of(page: Path, heading: str, number: int = 0) -> list[list[str]]:
    """Cells of a table after a heading, without its head; number: which one."""
    after = text_of(page).split(f"## {heading}\n", 1)[1]
    tables = re.findall(r"(?:^\|.*\n)+", after, re.MULTILINE)
    rows = tables[number].splitlines()[2:]
    return [[cell.strip() for cell in row.strip("| ").split(" | ")] for row in rows]


FRAMES = [row[0].strip("`") for row in rows_of(DOCS / "glossary.md", "Frames")]
FRAME_NAME = re.compile(r"\b(?:R|T|q|p)_([A-Z])([A-Z])(?:_hat)?\b")


def test_a_frame_is_one_letter_and_a_letter_one_frame():
    assert sorted(FRAMES) == sorted(set(FRAMES))
    assert set(FRAMES) == {"W", "L", "L_hat", "I", "B", "F", "C", "T", "N"}
    letters = [cells[1] for cells in rows_of(DOCS / "glossary.md", "Frames")]
    assert len(set(letters)) == len(letters)


def test_names_of_rotations_and_places_use_the_glossarys_frames():
    known, seen, wrong = {name[0] for name in FRAMES}, set(), []
    inner = [(row[0], row[2].strip("`")) for row in rows_of(DOCS / "glossary.md", "Frames", 1)]
    local = {(letter, place) for cell, place in inner for letter in re.findall(r"`(\w)`", cell)}
    for module in house.modules(ROOT):
        here = str(module.path.relative_to(ROOT))
        allowed = known | {letter for letter, place in local if here.startswith(place)}
        for node in house.nodes(module.tree):
            name = node.id if isinstance(node, ast.Name) else getattr(node, "arg", None)
            found = FRAME_NAME.fullmatch(name) if isinstance(name, str) else None
            if found:
                seen |= set(found.groups())
                if not set(found.groups()) <= allowed:
                    wrong.append(f"{here} line {node.lineno}: {name}")
    assert wrong == []
    assert seen == known | {letter for letter, _ in local}


def test_a_term_is_explained_once():
    terms = [row[0] for row in rows_of(DOCS / "glossary.md", "Terms")]
    assert sorted(terms) == sorted(set(terms))
    assert len(terms) > 40


def test_every_page_is_in_the_navigation():
    listed = set(re.findall(r"([\w/]+\.md)", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    pages = {str(p.relative_to(DOCS)) for p in PAGES if p.is_relative_to(DOCS)}
    assert pages == listed


def test_formulas_become_mathml_in_place():
    mkdocs_math = pytest.importorskip("mkdocs_math", reason="the extra `docs` is not installed")
    page = (
        '<p>with <span class="arithmatex">\\(a &lt; R_{WI}^T b\\)</span>.</p>'
        '<div class="arithmatex">\\[\nx := y\n\\]</div>'
    )
    out = mkdocs_math.with_mathml(page)
    assert out.count("<math") == 2
    assert 'display="block"' in out
    assert 'display="inline"' in out
    assert "\\(" not in out
    assert out.startswith("<p>with ")


def test_every_formula_of_the_pages_is_understood():
    """What the converter does not know it hands on as text with its backslash."""
    convert = pytest.importorskip("latex2mathml.converter", reason="extra `docs`").convert
    found = 0
    for page in PAGES:
        text = re.sub(r"^```.*?^```|`[^`\n]*`", "", text_of(page), flags=re.DOTALL | re.MULTILINE)
        for tex in re.findall(r"\$\$(.+?)\$\$|\$([^$\n]+)\$", text, re.DOTALL):
            found += 1
            assert "\\" not in convert("".join(tex).strip()), f"{page}: {tex}"
    assert found > 50


def test_a_page_without_its_mark_is_named():
    text = "a\n<!-- generated: x -->\nold\n<!-- end -->\nb\n"
    new = "a\n<!-- generated: x -->\n\\1 new\n<!-- end -->\nb\n"
    assert write_docs.filled(text, "x", "\\1 new\n", "p.md") == new
    with pytest.raises(SystemExit, match=r"p\.md: no `<!-- generated: y -->`"):
        write_docs.filled(text, "y", "", "p.md")


def test_an_arrow_that_a_longer_way_says_is_left_out():
    needs = {"d": {"c", "b", "a"}, "c": {"b"}, "b": {"a"}, "a": set()}
    assert picture.reduced(needs) == {"d": {"c"}, "c": {"b"}, "b": {"a"}, "a": set()}


def test_the_picture_can_be_read():
    """Each folder has a box, no two overlap, every arrow goes down, and it fits a page."""
    text = (DOCS / "architecture.svg").read_text(encoding="utf-8")
    found = re.findall(r'<rect x="(\d+)" y="(\d+)" width="(\d+)" height="(\d+)" rx', text)
    boxes = [tuple(map(int, box)) for box in found]
    drawn = [n for n in picture.order(ROOT) if n.split(".")[1] not in picture.FOUNDATIONS]
    assert len(boxes) == len(drawn) + 2  # and the two bars
    assert all(f">{name.split('.')[1]}</text>" in text for name in drawn)
    apart = [
        a[0] + a[2] <= b[0] or b[0] + b[2] <= a[0] or a[1] + a[3] <= b[1] or b[1] + b[3] <= a[1]
        for i, a in enumerate(boxes)
        for b in boxes[:i]
    ]
    assert all(apart)
    arrows = re.findall(r'<path d="M\d+ (\d+) .* (\d+)" fill="none"', text)
    assert len(arrows) > 30
    assert all(int(start) < int(end) for start, end in arrows)
    width, height = map(int, re.findall(r'viewBox="0 0 (\d+) (\d+)"', text)[-1])
    assert width <= 1000
    assert height <= 1200
