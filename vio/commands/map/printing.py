"""`tagvio map print`: a map at true size on sheets of paper or a roll, as a vector PDF."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands.options import OnlyTags
from vio.offline.choice import ids_of
from vio.terminal import progress

if TYPE_CHECKING:
    from tagvo.maps.printing import Print
    from tagvo.maps.printing.cutting import Paper


class PaperName(StrEnum):
    """Papers to choose from; a test holds them equal to `tagvo.maps.printing.cutting.PAPERS`."""

    A4 = "A4"
    A3 = "A3"
    A2 = "A2"
    A1 = "A1"
    A0 = "A0"


class Turn(StrEnum):
    """How the paper lies."""

    auto = "auto"
    portrait = "portrait"
    landscape = "landscape"


def command(
    path: Annotated[Path, typer.Argument(metavar="MAP", help="A tagmap.yaml.", show_default=False)],
    out: Annotated[
        Path, typer.Argument(metavar="OUT", help="The PDF to write.", show_default=False)
    ],
    paper: Annotated[
        PaperName, typer.Option("--paper", help="Paper.", case_sensitive=False)
    ] = PaperName.A4,
    roll: Annotated[
        float | None,
        typer.Option("--roll", metavar="WIDTH", min=1.0, help="A roll of WIDTH mm in its place."),
    ] = None,
    turn: Annotated[
        Turn, typer.Option("--turn", help="How the paper lies; auto: fewest sheets.")
    ] = Turn.auto,
    margin: Annotated[
        float, typer.Option("--margin", min=0.0, help="What the printer leaves white, mm.")
    ] = 5.0,
    overlap: Annotated[
        float, typer.Option("--overlap", min=0.0, help="What neighbours share, mm.")
    ] = 5.0,
    each: Annotated[bool, typer.Option("--each", help="One tag a sheet, in any plane.")] = False,
    only_tags: OnlyTags = None,
    numbers: Annotated[
        bool, typer.Option("--ids/--no-ids", help="The id beside each tag, where there is room.")
    ] = True,
    index: Annotated[
        bool, typer.Option("--index/--no-index", help="A first page with all sheets on it.")
    ] = True,
    title: Annotated[str | None, typer.Option("--title", help="Title; default: MAP.")] = None,
) -> None:
    """Print a map at true size: vector pages to lay side by side, with an index of the sheets.

    Sheets have crop marks at the corners of their part and show a little more than it; few tags
    are cut. Each has a ruler of 100 mm along and across the feed: measure both before you lay
    anything. Ids stand outside the tags, where there is white enough (`map new --quiet-zone`).
    Print at actual size (100 %), on matt paper.
    """
    import numpy as np

    from tagvo.maps.printing import draw_print, plan_print
    from tagvo.tags.tag_map import load_map

    if out.suffix.lower() != ".pdf":
        raise typer.BadParameter(f"{out}: a name in .pdf is needed", param_hint="OUT")
    ids = ids_of(only_tags)
    tag_map = load_map(path)
    if ids is not None:
        tag_map = tag_map.only(np.array(ids, dtype=np.int64))
    ready = plan_print(
        tag_map,
        _paper(paper, roll, turn, margin, overlap),
        each=each,
        numbers=numbers,
        title=title if title is not None else "/".join(path.parts[-2:]),
    )
    with progress(ready.sheets, "drawing") as step:
        pages = draw_print(ready, out, index=index, step=step)
    _report(ready, out, pages)


def _paper(
    name: PaperName, roll: float | None, turn: Turn, margin: float, overlap: float
) -> "Paper":
    from tagvo.maps.printing.cutting import LONGEST, Paper, named_paper

    if roll is None:
        called, (width, height) = name.value, named_paper(name.value)
    else:
        called, width, height = f"a roll of {roll:g} mm", 1e-3 * roll, LONGEST
    white, shared = 1e-3 * margin, 1e-3 * overlap
    return Paper(called, width, height, roll is not None, white, shared, turn.value)


def _report(ready: "Print", out: Path, pages: int) -> None:
    from tagvo.maps.printing.index import sheets_in_words

    tags = sum(len(d.plane.at) for d in ready.drawings)
    if ready.each:
        where = f"{ready.sheets} sheets of {ready.drawings[0].paper.name}, one tag each"
    else:
        where = sheets_in_words(ready.drawings[0])
    if ready.cut:
        where += f"; {ready.cut} tags lie on more than one"
    typer.echo(f"{out}: {tags} tags on {where}; {pages} pages")
    if ready.without_number:
        typer.echo(
            f"{len(ready.without_number)} tags have no white for an id beside them;"
            " the index shows all ids",
            err=True,
        )
    if ready.flattened > 1e-3:
        typer.echo(
            f"the tags lie up to {1e3 * ready.flattened:.1f} mm off one plane and are printed flat",
            err=True,
        )
    typer.echo("print at actual size (100 %) and measure the rulers: 100 mm")
