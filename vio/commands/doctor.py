"""`tagvio doctor`: what is wrong with a flight controller's set-up, and what to set."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vio.commands import options as opt
from vio.terminal import waiting

if TYPE_CHECKING:
    from vio.config.mavlink import MavlinkConfig
    from vio.doctor.records import Change, Facts, Finding
    from vio.doctor.session import Line

_HEARTBEAT_S = 10.0
Url = Annotated[
    str,
    typer.Option(
        "--connect", metavar="URL",
        help="udpin:HOST:PORT (listen), udpout:HOST:PORT, tcp:HOST:PORT or serial:DEV:BAUD.",
    ),
]  # fmt: skip
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="The configuration that will fly.")
]


def command(
    url: Url,
    config: ConfigFile = None,
    assignments: opt.Assignments = None,
    seconds: float = typer.Option(
        8.0,
        "--seconds",
        metavar="S",
        min=1.0,
        max=600.0,
        help="How long to listen at least; 55 shows whether PX4's TIMESYNC converges.",
    ),
    fix: bool = typer.Option(False, "--fix", help="Write what is wrong, after showing it."),
    yes: bool = typer.Option(False, "--yes", help="With --fix: do not ask."),
    wiggle: bool = typer.Option(
        False, "--wiggle", help="Walk through movements by hand; names a wrong axis."
    ),
    json_file: Path | None = typer.Option(
        None, "--json", metavar="FILE", help="Write all that was found there, too."
    ),
) -> None:
    """Examine an ArduPilot or PX4: parameters, clocks, rates, its filter, latency.

    Says what is wrong, why it matters and what to set. It only reads (and asks for the IMU, as in
    flight), unless --fix is given: that shows every change, asks, writes it and reads it back, and
    refuses while the vehicle is armed. Latency needs poses on the link: let the daemon send,
    through a router that hands its messages to this URL, too. Exit code 1 where a finding is an
    error.
    """  # fmt: skip
    from vio.config import load_config
    from vio.doctor.checks import failed
    from vio.doctor.session import Line

    words = [*(assignments or ()), f"mavlink.url={url}"]
    settings: MavlinkConfig = load_config(config, words).mavlink
    line = Line(settings)
    try:
        with _errors_alone():
            findings, content = _examine(line, url, seconds, fix, yes, wiggle)
    finally:
        line.close()
    if json_file is not None:
        import json

        from tagvo.textfile import write_atomic

        write_atomic(json_file, json.dumps(content, indent=1) + "\n")
        typer.echo(str(json_file))
    if failed(findings):
        raise typer.Exit(1)


@contextmanager
def _errors_alone() -> Iterator[None]:
    """Log errors only while the doctor is at work: its findings say the rest better."""
    import logging

    logger = logging.getLogger("vio")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def _examine(
    line: "Line", url: str, seconds: float, fix: bool, yes: bool, wiggle: bool
) -> "tuple[list[Finding], dict[str, object]]":
    """Do all that was asked for; the findings that remain, and what goes into the JSON file."""
    from vio.doctor import render
    from vio.doctor.checks import check

    with waiting(f"waiting for a heartbeat at {url}"):
        who = line.connect(_HEARTBEAT_S)
    with waiting(f"{who}: listening for {seconds:g} s"):
        facts, kinds = line.examine(seconds)
    findings = check(facts)
    typer.echo(f"{who}, {'armed' if facts.armed else 'disarmed'}: {render.counts_text(findings)}")
    typer.echo(render.measured_text(facts))
    if findings:
        typer.echo(render.findings_text(findings))
    written: list[dict[str, object]] = []
    if fix:
        facts, written = _fix(line, facts, findings, kinds, yes)
        findings = check(facts)
    if wiggle:
        findings = [*findings, *_wiggle(line)]
    return findings, {"vehicle": who, **render.content(facts, findings), "written": written}


def _fix(
    line: "Line", facts: "Facts", findings: "list[Finding]", kinds: dict[str, int], yes: bool
) -> "tuple[Facts, list[dict[str, object]]]":
    """Show, ask, write, read back; the facts as they are afterwards, and what was written."""
    from dataclasses import replace

    from vio.doctor.params import took
    from vio.errors import LinkError

    changes: dict[str, Change] = {}
    for finding in findings:
        if finding.change is not None and finding.change.name in kinds:
            changes.setdefault(finding.change.name, finding.change)
    if not changes:
        typer.echo("nothing to write")
        return facts, []
    if facts.armed:
        raise LinkError("the vehicle is armed: nothing is written; disarm it first")
    for change in changes.values():
        typer.echo(f"  {change.name}: {change.old:g} -> {change.new:g}")
    if not yes and not typer.confirm(f"Write these {len(changes)}?"):
        return facts, []
    with waiting("writing"):
        results = line.write(list(changes.values()), kinds)
    params, written = dict(facts.params), []
    for change in changes.values():
        read = results.get(change.name)
        held = took(change, read)
        params |= {} if read is None else {change.name: read}
        said = "written" if held else f"NOT taken (reads {'nothing' if read is None else read})"
        typer.echo(f"  {change.name} {change.new:g}: {said}")
        written.append({"name": change.name, "old": change.old, "new": change.new, "held": held})
    typer.echo("restart the flight controller and run the doctor again: some take effect only then")
    return replace(facts, params=params), written


def _wiggle(line: "Line") -> "list[Finding]":
    """Have the vehicle moved by hand; what its axes look like."""
    from vio.doctor import render
    from vio.doctor.hand_test import ORDERS

    typer.echo("Disarmed, propellers off, the daemon sending. Five steps; be still after each.")
    samples = line.hand_test()
    for order in ORDERS.values():
        typer.prompt(f"{order} Hold still, then press Enter", default="", show_default=False,
                     prompt_suffix="")  # fmt: skip
        line.rest(samples)
    found = samples.judge()
    typer.echo(render.findings_text(found) if found else "every axis is right")
    return found
