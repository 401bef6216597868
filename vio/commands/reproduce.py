"""`tagvio reproduce`: the paper's tables, simulated, ours beside theirs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from vio.commands import options as opt
from vio.interrupt import gently
from vio.offline.choice import make_folder
from vio.terminal import progress, waiting

if TYPE_CHECKING:
    from vio.reproduce.orderings import Ordering
    from vio.reproduce.records import Scores


def command(
    out: opt.OutFolder = Path("tagvio-reproduce"),
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer frames a second; under 10 minutes on two cores.")
    ] = False,
    corners: Annotated[
        bool,
        typer.Option("--corners", help="Exact corners with noise in place of rendered images."),
    ] = False,
    seed: Annotated[int, typer.Option("--seed", metavar="N", min=0, help="The first seed.")] = 1,
    seeds: Annotated[
        int, typer.Option("--seeds", metavar="N", min=1, max=1000, help="How many of them.")
    ] = 1,
    jobs: Annotated[
        int, typer.Option("--jobs", metavar="N", min=1, max=512, help="Processes at a time.")
    ] = 2,
    cluster: Annotated[
        str | None,
        typer.Option(
            "--cluster", metavar="ADDRESS", help="A Dask scheduler, as tcp://10.0.0.2:8786."
        ),
    ] = None,
) -> None:
    """Fly the paper's tests and put its tables, its orderings and its future work beside ours.

    Five hover places at three heights, T1 by phase, T2 by step and T3, each by the hexarotor (HR)
    and the quadrotor (QR): every column of the paper, and what it lacks: the FIR told apart, one
    tag in the filter, the joint pose, the filter by poses and by corners, with a calibrated rig and
    with every nuisance at once. Then tags hidden, sparse maps, latency and speed (by exact corners
    with noise).

    Images are rendered and searched for tags, once for all estimators. DIR/reproduce.md and
    DIR/report.html hold all tables, DIR/reproduce.json all figures. What is done is kept in
    DIR/flown: the same call goes on where it was stopped, by Ctrl-C too. Without --quick it takes
    about four times as long.
    """
    from vio.reproduce.orderings import orderings
    from vio.reproduce.plan import tasks
    from vio.reproduce.records import Scores
    from vio.reproduce.study import fly_all
    from vio.reproduce.tables import document

    make_folder(out)
    todo = tasks(seed, seeds, quick, not corners)
    _warm()
    found = []
    with progress(len(todo), "flying") as step, gently() as stop:
        for scores in fly_all(todo, out / "flown", jobs, cluster, step, stop):
            found.append(scores)
        interrupted = len(found) < len(todo)
    every = Scores(s for scores in found for s in scores)
    claims = orderings(every)
    head = _head(seed, seeds, quick, corners, len(found), len(todo))
    _write(out, document(every, claims, head), _content(every, claims, head))
    _say(claims, interrupted, len(found), len(todo))
    if interrupted:
        raise typer.Exit(130)


def _write(out: Path, text: str, content: dict[str, Any]) -> None:
    """All tables as Markdown and as a page, all figures as JSON."""
    from tagvo.textfile import write_atomic
    from vio.evaluate.compare import write_json
    from vio.evaluate.report.html import page_of_markdown

    write_atomic(out / "reproduce.md", text)
    write_atomic(out / "report.html", page_of_markdown("tagvio reproduce", text))
    write_json(out / "reproduce.json", content)
    typer.echo(f"{out / 'reproduce.md'}, {out / 'reproduce.json'}, {out / 'report.html'}")


def _warm() -> None:
    """Compile before processes start, or each would."""
    from tagvo.camera.calibration import load_camera
    from tagvo.tags.tag_map import load_map
    from vio.commands.warmup import warm_flight
    from vio.config.shipped import config_path
    from vio.localize.warmup import warm_renderer

    with waiting("loading compiled code (the first run compiles it, some minutes)"):
        warm_flight()
        floor, camera = config_path("maps/arena.yaml"), config_path("cameras/arena.yaml")
        warm_renderer(load_map(floor), load_camera(camera))


def _head(seed: int, seeds: int, quick: bool, corners: bool, done: int, total: int) -> str:
    from importlib.metadata import version

    from vio.reproduce.plan import QUICK_HZ, RATE_HZ

    words = [f"--seed {seed}", f"--seeds {seeds}", *(["--quick"] if quick else []),
             *(["--corners"] if corners else [])]  # fmt: skip
    source = "exact corners with noise" if corners else "rendered images, searched for tags"
    rate = QUICK_HZ if quick else RATE_HZ
    text = (
        f"Made by `tagvio reproduce {' '.join(words)}` (tagvio {version('tagvio')}), from"
        f" {source}, {rate:g} a second; future work from exact corners with noise."
    )
    return text if done == total else f"{text} **Interrupted: {done} of {total} flights.**"


def _content(scores: "Scores", claims: "list[Ordering]", head: str) -> dict[str, Any]:
    from dataclasses import asdict

    rows = []
    for s in scores.all:
        names = {k: getattr(s, k) for k in ("study", "case", "phase", "arm", "view", "n")}
        rows.append(
            names
            | {
                "position_mean_m": s.p_mean, "position_std_m": s.p_std, "position_rmse_m": s.p_rms,
                "rotation_mean_deg": s.o_mean, "rotation_std_deg": s.o_std,
                "rotation_rmse_deg": s.o_rms, "coverage": s.coverage,
            }
        )  # fmt: skip
    return {"made": head, "scores": rows, "orderings": [asdict(c) for c in claims]}


def _say(claims: "list[Ordering]", interrupted: bool, done: int, total: int) -> None:
    for claim in claims:
        if claim.held is not None:
            word = "held    " if claim.held else "NOT HELD"
            why = f" ({claim.reason})" if claim.reason else ""
            typer.echo(f"{word} {claim.claim}: {claim.figures}{why}")
    known = [c.held for c in claims if c.held is not None]
    typer.echo(f"{sum(known)} of {len(known)} orderings held")
    if interrupted:
        typer.echo(
            f"stopped by Ctrl-C after {done} of {total} flights; the same call goes on", err=True
        )
