"""The command `tagvio`: one file a subcommand, heavy imports only inside the one that runs."""

import sys

import typer

from tagvo.errors import TagvoError
from vio.commands import (
    bench,
    compare,
    convert,
    daemon,
    demo,
    doctor,
    replay,
    reproduce,
    run,
    simulate,
    warmup,
)
from vio.commands import map as map_commands
from vio.errors import VioError
from vio.interrupt import interruptible

app = typer.Typer(
    name="tagvio",
    help="Visual-inertial localization for indoor UAVs over a map of fiducial tags.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help wraps its paragraphs and keeps [s]
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("run")(run.command)
app.command("compare")(compare.command)
app.command("demo")(demo.command)
app.command("daemon")(daemon.command)
app.command("replay")(replay.command)
app.command("simulate")(simulate.command)
app.command("reproduce")(reproduce.command)
app.command("convert")(convert.command)
app.command("bench")(bench.command)
app.command("warmup")(warmup.command)
app.command("doctor")(doctor.command)
app.add_typer(map_commands.app, name="map")


@app.callback(invoke_without_command=True)
def _main(
    version: bool = typer.Option(False, "--version", help="Print the version.", is_eager=True),
) -> None:
    if version:
        from importlib.metadata import version as installed

        typer.echo(f"tagvio {installed('tagvio')}")
        raise typer.Exit


def main() -> None:
    """Entry point: a known error is one line on stderr and exit code 1, a bug its traceback."""
    try:
        with interruptible():
            app()
    except (TagvoError, VioError, OSError) as err:
        text = " ".join(str(err).split())
        typer.echo(f"tagvio: {text}", err=True)
        sys.exit(1)
