"""Shows that every runtime dependency installs on a companion computer: aarch64, Python 3.11, 3.13.

Run: python tools/check_wheels.py    Needs pip and the network; exit 1 where a wheel is missing.

pip's resolver is asked for the whole tree as that platform would get it, wheels alone (markers
such as python_version are those of the Python that asks).
"""

import json
import re
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from pathlib import Path

PYTHONS = ("3.11", "3.13")
GLIBC = (17, 24, 26, 27, 28, 31, 34, 35)  # Raspberry Pi OS 12 has glibc 2.36
PLATFORMS = ["manylinux2014_aarch64", *(f"manylinux_2_{n}_aarch64" for n in GLIBC)]
ROOT = Path(__file__).parents[1]


@dataclass(frozen=True, slots=True)
class Wheel:
    """One wheel that pip would take: version, and aarch64 or pure."""

    version: str
    kind: str


def canonical(name: str) -> str:
    """Name of a package as registries compare it, without version and extras."""
    return re.split(r"[^\w.-]", name)[0].lower().replace("_", "-")


def resolve(requirements: list[str], python: str) -> dict[str, Wheel]:
    """The wheels that pip would install there, by package; empty where it cannot."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [
            sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--no-input",
            "--ignore-installed", "--disable-pip-version-check", "--only-binary=:all:",
            f"--python-version={python}", "--implementation=cp", f"--target={folder}/site",
            f"--report={report}", *(f"--platform={p}" for p in PLATFORMS), *requirements,
        ]  # fmt: skip
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return {}
        return dict(_wheel(item) for item in json.loads(report.read_text())["install"])


def _wheel(item: dict[str, dict[str, str]]) -> tuple[str, Wheel]:
    kind = "aarch64" if "aarch64" in item["download_info"]["url"] else "pure"
    return canonical(item["metadata"]["name"]), Wheel(item["metadata"]["version"], kind)


def main() -> int:
    """Print the table, direct dependencies first; 1 where a tree cannot be had in wheels."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    requirements: list[str] = project["dependencies"]
    direct = {canonical(r) for r in requirements}
    trees = {python: resolve(requirements, python) for python in PYTHONS}
    names = {name for tree in trees.values() for name in tree}
    print(f"{'package':34}" + "".join(f"{'Python ' + p:24}" for p in PYTHONS))
    for name in sorted(names, key=lambda n: (n not in direct, n)):
        wheels = [tree.get(name) for tree in trees.values()]
        cells = [f"{w.kind} {w.version}" if w else "-" for w in wheels]
        print(f"{name if name in direct else '  ' + name:34}" + "".join(f"{c:24}" for c in cells))
    missing = [python for python, tree in trees.items() if not tree]
    for python in missing:
        alone = [r for r in requirements if not resolve([r], python)]
        what = ", ".join(alone) or "each can be had alone, but not together"
        print(f"Python {python}: no wheels for aarch64: {what}")
    if not missing:
        print(f"all {len(names)} packages have a wheel for aarch64 or are pure Python")
    return int(bool(missing))


if __name__ == "__main__":
    sys.exit(main())
