"""`tagvio map`: design, print, check, show and convert the files that say which tag lies where."""

from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands.map import new, printing, views

if TYPE_CHECKING:
    from tagvo.tags.tag_map import TagMap

app = typer.Typer(
    name="map",
    help="Look after tag maps: design, print, check and draw them, convert other people's.",
    no_args_is_help=True,
)
app.command("new", epilog="Example: tagvio map new hall.yaml --size 4,6 --heights 0.5,3")(
    new.command
)
app.command(
    "print",
    epilog="Examples: tagvio map print hall.yaml hall.pdf --paper A0"
    " · tagvio map print hall.yaml hall.pdf --roll 914"
    " · tagvio map print hall.yaml tags.pdf --each --only-tags 3,17",
)(printing.command)
app.command("views", epilog="Example: tagvio map views configs/maps/arena.yaml")(views.command)


class MapFormat(StrEnum):
    """Names of the map formats; a test holds them equal to `tagvo.maps.formats.FORMATS`."""

    tagmap = "tagmap"
    apriltag_ros1 = "apriltag_ros1"
    apriltag_ros2 = "apriltag_ros2"
    wpilib = "wpilib"
    wpilib2027 = "wpilib2027"
    limelight = "limelight"
    tagslam = "tagslam"
    clover = "clover"
    fiducials = "fiducials"
    kalibr = "kalibr"


MapFile = Annotated[Path, typer.Argument(metavar="MAP", help="A tagmap.yaml.", show_default=False)]
AnyMapFile = Annotated[
    Path,
    typer.Argument(metavar="MAP", help="A map in any format of `convert`.", show_default=False),
]
SizeOption = Annotated[
    float | None,
    typer.Option("--size", min=1e-6, help="Border side in metres, where the file gives no size."),
]
FamilyOption = Annotated[
    str | None, typer.Option("--family", help="Tag family, where the file names none.")
]


@app.command(
    epilog="Example: tagvio map check configs/maps/arena.yaml. Exit code 1 where there is an error."
)
def check(path: MapFile) -> None:
    """List every fault of a map, and its size classes.

    Errors: ids twice or outside the family, sizes (1 mm to 10 m), places (to 10 km) and rotations
    that are none, borders that overlap. Warnings: printed margins that overlap, sizes that differ
    by total/border. Many findings are summed up in 20 lines.
    """
    from tagvo.errors import MapError
    from tagvo.maps.check import check_map_data, summed_up
    from tagvo.tags.tag_map import map_from_dict
    from tagvo.textfile import read_yaml

    data = read_yaml(path, MapError)
    findings = check_map_data(data, str(path))
    for line in summed_up(findings):
        typer.echo(line)
    errors = sum(finding.severity == "error" for finding in findings)
    with suppress(MapError):  # overlapping tags load, a map with other errors does not
        _echo_classes(map_from_dict(data, str(path)))
    typer.echo(f"{path}: {errors} errors, {len(findings) - errors} warnings")
    if errors:
        raise typer.Exit(1)


def _echo_classes(tag_map: "TagMap") -> None:
    from tagvo.maps.check import size_classes

    typer.echo(f"{len(tag_map)} tags of {tag_map.family.name}, size_kind {tag_map.size_kind}:")
    for c in size_classes(tag_map):
        typer.echo(f"  border {1e3 * c.border:g} mm, total {1e3 * c.total:g} mm: {c.count} tags")


@app.command(epilog="Example: tagvio map show tagmap.yaml --out map.svg --title 'Hall 2'")
def show(
    path: AnyMapFile,
    out: Annotated[Path, typer.Option("--out", "-o", help="Picture, .png or .svg.")] = Path(
        "map.png"
    ),
    title: Annotated[str | None, typer.Option("--title", help="Headline; default: MAP.")] = None,
    size: SizeOption = None,
    family: FamilyOption = None,
) -> None:
    """Draw a map: ids, size classes, each tag's x (red) and y (green), W's axes, a metric grid.

    Walls are drawn from the front; tags on several surfaces from above a corner, with a panel each.
    """
    from tagvo.maps.draw.page import draw_map
    from tagvo.maps.formats import read_map_file

    if out.suffix.lower() not in (".png", ".svg"):
        raise typer.BadParameter(f"{out}: a name in .png or .svg is needed", param_hint="--out")
    imported = read_map_file(path, size=size, family=family)
    draw_map(imported.tag_map, out, title)
    typer.echo(f"{out}: {len(imported.tag_map)} tags drawn")


@app.command(
    epilog="Examples: tagvio map convert field.json tagmap.yaml --size 0.1651"
    " · tagvio map convert tagmap.yaml field.fmap --to limelight"
    " · tagvio map convert tags.yaml tagmap.yaml --bundle floor --family tagStandard41h12"
)
def convert(
    source: Annotated[Path, typer.Argument(metavar="IN", help="The map to read.")],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="The map to write.")],
    from_: Annotated[
        MapFormat | None, typer.Option("--from", help="Format of IN; default: by its content.")
    ] = None,
    to: Annotated[
        MapFormat | None,
        typer.Option("--to", help="Format of OUT; default: tagmap for .yaml, limelight for .fmap."),
    ] = None,
    size: SizeOption = None,
    family: FamilyOption = None,
    bundle: Annotated[
        str | None,
        typer.Option("--bundle", help="Which map of several: a bundle's or a body's name."),
    ] = None,
    layout: Annotated[
        Path | None,
        typer.Option("--layout", help="Map with the poses, where IN gives sizes alone."),
    ] = None,
) -> None:
    """Convert a map from one format to another, and say what the new one cannot hold.

    Tag axes are turned at the border: ours are x right, y up, z out of the printed face.
    """
    from tagvo.maps.formats import read_map_file, write_map_file

    fmt = to or _format_by_name(target)
    name = None if from_ is None else from_.value
    imported = read_map_file(source, name, size=size, family=family, bundle=bundle, layout=layout)
    for note in imported.notes:
        typer.echo(f"note: {note}", err=True)
    for loss in write_map_file(imported.tag_map, target, fmt.value):
        typer.echo(f"lost: {loss}", err=True)
    typer.echo(f"{target}: {len(imported.tag_map)} tags written as {fmt.value}")


def _format_by_name(target: Path) -> MapFormat:
    by_suffix = {".yaml": MapFormat.tagmap, ".yml": MapFormat.tagmap, ".fmap": MapFormat.limelight}
    if target.suffix.lower() not in by_suffix:
        raise typer.BadParameter(f"{target}: the name does not tell its format", param_hint="--to")
    return by_suffix[target.suffix.lower()]
