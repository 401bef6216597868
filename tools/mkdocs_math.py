"""A hook of mkdocs: a page's formulas become MathML while it is built; no page needs a script.

`pymdownx.arithmatex` marks them; browsers have shown MathML by themselves since 2023.
"""

import html
import re
from typing import Any

from latex2mathml.converter import convert

_MARKED = re.compile(
    r'<(?P<tag>span|div) class="arithmatex">\\(?P<kind>[\(\[])(?P<tex>.*?)\\[\)\]]</(?P=tag)>',
    re.DOTALL,
)


def with_mathml(page: str) -> str:
    """A page's HTML with its marked formulas as MathML."""

    def one(found: re.Match[str]) -> str:
        display = "block" if found["kind"] == "[" else "inline"
        math = convert(html.unescape(found["tex"]).strip(), display=display)
        return f'<{found["tag"]} class="arithmatex">{math}</{found["tag"]}>'

    return _MARKED.sub(one, page)


def on_page_content(content: str, **_: Any) -> str:
    """What mkdocs calls with each page's HTML."""
    return with_mathml(content)
