"""`tagvio map views`: how many tags of use a camera sees from where over a map, by height."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands.map import options as opt
from vio.terminal import progress

if TYPE_CHECKING:
    from tagvo.camera.model import Camera
    from tagvo.geometry import Array
    from tagvo.tags.tag_map import TagMap


def command(
    paths: Annotated[
        list[Path], typer.Argument(metavar="MAP...", help="Each a tagmap.yaml.", show_default=False)
    ],
    camera: opt.CameraFile = None,
    heights: opt.Heights = "0.3,2.5",
    min_px: opt.MinPx = 20.0,
) -> None:
    """Table by height of the tags of use in view, and the figure that `map new` maximises.

    A tag is of use in a view where its whole print lies in the image and each side of its border
    is at least --min-px long. The camera is level and looks straight at the map from the middle
    of each cell of a grid of about 0.1 m, its x axis along the map's x, then along its y. The
    objective is the mean over the heights of the mean of log2(1 + tags) over the poorest fifth
    of the views of that height.
    """
    from tagvo.tags.tag_map import load_map

    lens, levels = opt.camera_of(camera), opt.heights_of(heights)
    for i, path in enumerate(paths):
        tag_map = load_map(path)
        typer.echo(f"{chr(10) if i else ''}{path}: {len(tag_map)} tags")
        echo_views(tag_map, lens, levels, min_px)


def echo_views(tag_map: "TagMap", camera: "Camera", heights: "Array", min_px: float) -> float:
    """Print the table of a map and its objective, in bits; -> the objective."""
    import numpy as np

    from tagvo.maps.design.coverage import by_height, counts_in_view, score, worth_in_tags

    rows = []
    with progress(len(heights), "looking") as step:
        for height in heights:
            rows.append(counts_in_view(tag_map, camera, np.array([height]), min_px))
            step()
    counts = np.concatenate(rows)
    typer.echo(f"tags of use in view: whole, border at least {min_px:g} px")
    typer.echo("  height   median   5th percentile   views without")
    for row in by_height(heights, counts):
        typer.echo(
            f"  {row.height:4.2f} m {row.median:8.4g} {row.p5:16.0f} {100 * row.blind:13.1f} %"
        )
    bits = score(counts)
    typer.echo(
        f"objective {bits:.3f}: the poorest fifth of the views is worth"
        f" {worth_in_tags(bits):.1f} tags a view"
    )
    return bits
