"""Finds the configurations and maps that come with the package, installed or in a checkout."""

from importlib.resources import files
from pathlib import Path

from vio.errors import VioError


def config_path(name: str) -> Path:
    """Path of a file of `configs/`, such as maps/arena.yaml; VioError where there is none."""
    inside_wheel = Path(str(files("vio"))) / "configs" / name
    in_checkout = Path(__file__).parents[2] / "configs" / name
    for path in (inside_wheel, in_checkout):
        if path.is_file():
            return path
    raise VioError(f"configs/{name}: no such file came with this installation of tagvio")


def config_names(folder: str) -> list[str]:
    """Names (without .yaml) of the files of a folder of `configs/`, such as scenarios, sorted."""
    homes = (Path(str(files("vio"))) / "configs", Path(__file__).parents[2] / "configs")
    return sorted({path.stem for home in homes for path in (home / folder).glob("*.yaml")})
