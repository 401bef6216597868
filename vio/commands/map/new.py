"""`tagvio map new`: designs a floor of tags of several sizes for what a camera will see of it."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands.map import options as opt
from vio.commands.map.views import echo_views
from vio.interrupt import gently
from vio.terminal import progress

if TYPE_CHECKING:
    from tagvo.maps.design.plan import MapWish, Plan

_HEAD = """\
# {x:g} m x {y:g} m of floor: x, y along it, z up, W at a corner. {tags} tags of {family}.
# {copies} of {w} x {h} units of {pitch:g} mm, {white:g} mm of white between prints.
# Made by: tagvio map new {options}
# The poorest fifth of its views from {low:g} to {high:g} m: {bits:.3f} bits ({first:.3f} at first).
"""


Out = Annotated[
    Path, typer.Argument(metavar="OUT", help="The tagmap.yaml to write.", show_default=False)
]
Size = Annotated[
    str, typer.Option("--size", metavar="W,H", help="The floor along x and y, in metres.")
]
Sizes = Annotated[
    str, typer.Option("--sizes", metavar="S,S,..", help="Border sides of the classes, in metres.")
]
Shares = Annotated[
    str | None,
    typer.Option(
        "--shares",
        metavar="A,A,..",
        help="Shares of the area by class; default: twice as much for the smallest as for each"
        " other. They need not sum to 1.",
    ),
]
FamilyName = Annotated[str, typer.Option("--family", help="Tag family, as in `map check`.")]
QuietZone = Annotated[
    float,
    typer.Option(
        "--quiet-zone",
        min=0.0,
        help="White between prints of the smallest class, in metres; more around larger ones."
        " 0 packs them edge to edge and leaves no room for printed ids.",
    ),
]
Tiles = Annotated[
    str | None,
    typer.Option("--tiles", metavar="NX,NY", help="Tiles along x and y; default: chosen."),
]
FirstId = Annotated[int, typer.Option("--first-id", min=0, help="Id of the first tag.")]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Another seed, another map.")]
Steps = Annotated[int, typer.Option("--steps", min=0, help="How many arrangements are tried.")]


def command(
    out: Out,
    size: Size = "3,5",
    sizes: Sizes = "0.46,0.23,0.115,0.0575",
    shares: Shares = None,
    family: FamilyName = "tagStandard41h12",
    quiet_zone: QuietZone = 0.0035,
    tiles: Tiles = None,
    first_id: FirstId = 0,
    heights: opt.Heights = "0.3,2.5",
    camera: opt.CameraFile = None,
    min_px: opt.MinPx = 20.0,
    seed: Seed = 41,
    steps: Steps = 8000,
) -> None:
    """Design a dense floor of tags of several sizes, for what a camera will see of it.

    One tile is a grid of units, each as wide as the smallest print and its white; larger tags take
    2, 4 or 8 units a side. The tile is repeated over the floor, each copy as it is, mirrored, or
    turned by 180 degrees. A seeded search arranges the tile and its copies; it maximises

    the mean over 12 heights of the mean, over the poorest fifth of the views of that height, of
    log2(1 + n), n being the tags of use in view: whole print in the image, border at least
    --min-px long. A low quantile, so that no place starves; the logarithm, so that no height does.

    `tagvio map views` explains the views and shows the same table for any map. Ctrl-C ends the
    search and writes the best so far.
    """
    import numpy as np

    from tagvo.maps.design.plan import lay_out, plan_map, search_tile
    from tagvo.tags.tag_map import map_to_yaml
    from tagvo.textfile import write_atomic

    wish = _wish(size, sizes, shares, family, quiet_zone, tiles, first_id)
    lens, levels = opt.camera_of(camera), opt.heights_of(heights)
    rng = np.random.default_rng(seed)
    plan, start = plan_map(wish, rng)
    _echo_plan(wish, plan)
    with progress(steps, "arranging the tile") as step, gently() as stop:
        found = search_tile(
            plan, start, lens, levels, rng, steps=steps, min_px=min_px, step=step, stop=stop
        )
        interrupted = stop()
    tag_map = lay_out(wish, plan, found, rng)
    bits = echo_views(tag_map, lens, levels, min_px)
    typer.echo(f"the search went from {found.first_score:.3f} to {found.score:.3f}")
    head = _HEAD.format(
        x=wish.size[0], y=wish.size[1], tags=len(tag_map), family=wish.family.name,
        copies=_copies(plan), w=plan.tile[0], h=plan.tile[1], pitch=1e3 * plan.grid.pitch,
        white=1e3 * wish.quiet_zone, low=levels[0], high=levels[-1], bits=bits,
        first=found.first_score, options=_options(wish, heights, camera, min_px, seed, steps),
    )  # fmt: skip
    write_atomic(out, head + map_to_yaml(tag_map))
    typer.echo(f"{out}: {len(tag_map)} tags written")
    if interrupted:
        typer.echo("stopped by Ctrl-C; the map is the best so far", err=True)
        raise typer.Exit(130)


def _wish(
    size: str,
    sizes: str,
    shares: str | None,
    family: str,
    quiet_zone: float,
    tiles: str | None,
    first_id: int,
) -> "MapWish":
    from tagvo.maps.design.plan import MapWish, usual_shares
    from tagvo.tags.families import family_named

    wide, high = opt.numbers(size, "--size", "3,5", 2)
    borders = opt.numbers(sizes, "--sizes", "0.46,0.23,0.115,0.0575")
    parts = usual_shares(borders) if shares is None else opt.numbers(shares, "--shares", "1,1,1,2")
    count = None
    if tiles is not None:
        nx, ny = opt.numbers(tiles, "--tiles", "2,4", 2)
        if min(nx, ny) < 1 or nx % 1 or ny % 1:
            raise typer.BadParameter(f"{tiles!r}; two whole numbers", param_hint="--tiles")
        count = (int(nx), int(ny))
    named = family_named(family, "--family")
    return MapWish((wide, high), borders, parts, named, quiet_zone, first_id, count)


def _copies(plan: "Plan") -> str:
    nx, ny = plan.repeats
    return f"{nx} x {ny} tiles" if nx * ny > 1 else "1 tile"


def _echo_plan(wish: "MapWish", plan: "Plan") -> None:
    grid, last = plan.grid, wish.first_id + plan.tags - 1
    typer.echo(
        f"{_copies(plan)} of {plan.tile[0]} x {plan.tile[1]} units of {1e3 * grid.pitch:g} mm;"
        f" {plan.tags} tags of {wish.family.name}, ids {wish.first_id} to {last}"
    )
    area, copies = plan.tile[0] * plan.tile[1], plan.repeats[0] * plan.repeats[1]
    counts = (*plan.counts, plan.smallest)
    for border, total, side, n in zip(grid.border, grid.total, grid.side, counts, strict=True):
        typer.echo(
            f"  border {1e3 * border:g} mm, total {1e3 * total:g} mm: {n * copies} tags,"
            f" {100 * n * side * side / area:.0f} % of the area"
        )


def _options(
    wish: "MapWish", heights: str, camera: Path | None, min_px: float, seed: int, steps: int
) -> str:
    """The options that make the same map again, the defaults among them."""

    def joined(values: tuple[float, ...]) -> str:
        return ",".join(f"{v:.10g}" for v in values)

    words = [
        f"--size {joined(wish.size)} --sizes {joined(wish.sizes)} --shares {joined(wish.shares)}",
        f"--family {wish.family.name} --quiet-zone {wish.quiet_zone:.10g}",
        f"--first-id {wish.first_id} --heights {heights} --min-px {min_px:g}",
        f"--seed {seed} --steps {steps}",
    ]
    if wish.tiles is not None:
        words.append(f"--tiles {wish.tiles[0]},{wish.tiles[1]}")
    if camera is not None:
        words.append(f"--camera {camera}")
    return " ".join(words)
