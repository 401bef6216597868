"""Options that the map commands share, and how their lists of numbers are read."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tagvo.camera.model import Camera
    from tagvo.geometry import Array

CameraFile = Annotated[
    Path | None,
    typer.Option("--camera", metavar="FILE", help="Calibration; default: the arena's camera."),
]
Heights = Annotated[
    str, typer.Option("--heights", metavar="LOW,HIGH", help="Heights over the map, in metres.")
]
MinPx = Annotated[
    float, typer.Option("--min-px", min=1.0, help="Shortest border side of a tag of use, pixels.")
]


def numbers(text: str, hint: str, example: str, count: int | None = None) -> tuple[float, ...]:
    """Numbers with commas between them, `count` of them where it is given; else wrong usage."""
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if not values or (count is not None and len(values) != count):
        many = "numbers" if count is None else f"{count} numbers"
        raise typer.BadParameter(
            f"{text!r}; {many} with commas are needed, as {example}", param_hint=hint
        )
    return values


def heights_of(text: str) -> "Array":
    """The heights [m] that LOW,HIGH stands for."""
    from tagvo.maps.design.coverage import heights_between

    low, high = numbers(text, "--heights", "0.3,2.5", 2)
    if not 0.0 < low <= high <= 1e3:
        raise typer.BadParameter(
            f"{text!r}; 0 < LOW <= HIGH is needed, in metres", param_hint="--heights"
        )
    return heights_between(low, high)


def camera_of(path: Path | None) -> "Camera":
    """The camera of a file, or the arena's."""
    from tagvo.camera.calibration import load_camera
    from vio.config.shipped import config_path

    return load_camera(path or config_path("cameras/arena.yaml"))
