"""Pages of HTML that need nothing else, from the templates beside this file."""

import base64
from functools import cache
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jinja2 import Environment


def render(template: str, **content: Any) -> str:
    """A page from `templates/`: a value is escaped unless the template marks it safe."""
    return _environment().get_template(template).render(content)


def page_of_markdown(title: str, text: str) -> str:
    """A whole HTML page of a Markdown document with tables."""
    from markdown_it import MarkdownIt

    body = MarkdownIt("commonmark", {"html": False}).enable("table").render(text)
    wide = body.replace("<table>", '<div class="wide"><table>').replace(
        "</table>", "</table></div>"
    )
    return render("page.html", title=title, body=wide, library="")


@cache
def _environment() -> "Environment":
    """A name that a template misspells is an error, not an empty place."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader(__package__),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters["base64"] = lambda data: base64.b64encode(data).decode()
    return made
