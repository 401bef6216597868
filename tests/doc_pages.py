"""README and the pages of docs/ as tests read them: code blocks, commands, links."""

import re
import shlex
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))


@dataclass(frozen=True)
class Chain:
    """Commands of one section, which run one after the other."""

    page: Path
    heading: str
    lines: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.page.stem}: {self.heading}"


def text_of(page: Path) -> str:
    """A page's text."""
    return page.read_text(encoding="utf-8")


def blocks(text: str, kind: str) -> list[str]:
    """Contents of the fenced blocks of one kind."""
    return re.findall(rf"^```{kind}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def console_lines(text: str) -> list[str]:
    """Commands of the console blocks, without their prompts and outputs."""
    return [
        line[2:] for b in blocks(text, "console") for line in b.splitlines() if line[:2] == "$ "
    ]


def chains() -> list[Chain]:
    """The sections of all pages that have commands to run."""
    found = []
    for page in PAGES:
        for section in re.split(r"^(?=##? )", text_of(page), flags=re.MULTILINE):
            lines = tuple(console_lines(section))
            if lines:
                found.append(Chain(page, section.splitlines()[0].strip("# "), lines))
    return found


def tagvio_calls(lines: tuple[str, ...] | list[str]) -> list[list[str]]:
    """The words after `tagvio` of each command of that name, wherever it is installed."""
    calls = [shlex.split(part) for line in lines for part in line.split("&&")]
    return [words[1:] for words in calls if words and Path(words[0]).name == "tagvio"]


def written_calls() -> list[list[str]]:
    """Every call of `tagvio` on any page: in blocks that run or do not, and in the text."""
    calls = []
    for text in map(text_of, PAGES):
        shown = [line for block in blocks(text, "text") for line in block.splitlines()]
        inline = re.findall(r"`(tagvio [^`\n]*)`", text)
        plain = [line for line in (*shown, *inline) if line.startswith("tagvio ")]
        calls += tagvio_calls([*console_lines(text), *plain])
    return calls
