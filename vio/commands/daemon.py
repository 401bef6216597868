"""`tagvio daemon`: flies, until it is told to stop."""

import signal
import threading
from pathlib import Path

import typer

from vio.commands import options as opt


def command(
    config: Path = typer.Option(
        ..., "--config", metavar="FILE", help="Configuration; configs/daemon.yaml shows one."
    ),
    assignments: opt.Assignments = None,
    check: bool = typer.Option(
        False, "--check", help="Check files, link, camera and folders, say so, and send nothing."
    ),
) -> None:
    """Fly: camera and the autopilot's IMU through the filter, poses to the flight controller.

    The section `daemon` of the configuration names map, calibration, camera and recording, the
    section `mavlink` the link. All is checked before anything is sent. Ends within a second on
    SIGTERM or Ctrl-C. Its log goes to stderr, a line a second; daemon.status_file holds all
    figures. tools/tagvio.service runs it under systemd.
    """
    from vio.config import load_config
    from vio.daemon import main
    from vio.interrupt import gently

    start_log()
    loaded = load_config(config, assignments or ())
    if check:
        parts, bridge, open_it = main.check(loaded, config)
        bridge.try_link()
        for text in (*parts.camera.notes, *main.tags_in_sight(parts, open_it)):
            typer.echo(f"warning: {text}", err=True)
        typer.echo(f"{config}: all is there; nothing was sent")
        return
    ended = threading.Event()
    before = signal.signal(signal.SIGTERM, lambda number, frame: ended.set())
    try:
        with gently() as asked:
            result = main.fly(loaded, config, lambda: ended.is_set() or asked())
            interrupted = asked()
    finally:
        signal.signal(signal.SIGTERM, before)
    if result is not None:
        typer.echo(f"{result.frames} frames, {result.with_pose} with a pose; {result.imu} samples")
    if interrupted:
        raise typer.Exit(130)


def start_log() -> None:
    """Log to stderr, in lines that a journal puts a time to."""
    import logging

    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s")
