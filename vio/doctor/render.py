"""Findings and measurements in words for a terminal, and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from textwrap import fill
from typing import Any

from vio.doctor.records import Facts, Finding, Severity
from vio.doctor.rules.delay import delay, words

_WIDTH = 96


def findings_text(findings: Sequence[Finding]) -> str:
    """A paragraph for each."""
    return "\n".join(_paragraph(f) for f in findings)


def _paragraph(f: Finding) -> str:
    indent = " " * 9
    text = f"{f.what}: {f.why}" if f.why else f.what
    lines = [fill(text, _WIDTH, initial_indent=f"{f.severity.value:<9}", subsequent_indent=indent)]
    if f.do:
        lines.append(fill(f"-> {f.do}", _WIDTH, initial_indent=indent, subsequent_indent=indent))
    return "\n".join(lines)


def counts_text(findings: Sequence[Finding]) -> str:
    """How many of each severity."""
    parts = []
    for severity in (Severity.ERROR, Severity.WARNING):
        n = sum(f.severity is severity for f in findings)
        parts.append(f"{n} {severity.value}{'' if n == 1 else 's'}")
    return ", ".join(parts)


def measured_text(facts: Facts) -> str:
    """What was measured, a line each."""
    lines = [f"{len(facts.params)} parameters read in {facts.seconds:.0f} s of listening"]
    if facts.rtts_ms:
        ordered = sorted(facts.rtts_ms)
        p95 = ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))]
        asked = f", ours was asked for {facts.timesync_asked} times"
        lines.append(
            f"clock: round trip least {ordered[0]:.1f}, p95 {p95:.1f} ms of {len(ordered)}{asked}"
        )
    if facts.imu_hz is not None:
        lines.append(f"IMU: {facts.config.imu.message} at {facts.imu_hz:.0f} Hz")
    lines.append(words(delay(facts)))
    return "\n".join(fill(line, _WIDTH, subsequent_indent="  ") for line in lines)


def content(facts: Facts, findings: Sequence[Finding]) -> dict[str, Any]:
    """All of it for `--json`."""
    d = delay(facts)
    return {
        "autopilot": "ardupilot" if facts.autopilot == 3 else "px4",
        "url": facts.config.url,
        "armed": facts.armed,
        "seconds": round(facts.seconds, 3),
        "findings": [
            {**asdict(f), "severity": f.severity.value, "change": _change(f)} for f in findings
        ],
        "parameters": dict(sorted(facts.params.items())),
        "parameters_complete": facts.complete,
        "timesync": {"asked": facts.timesync_asked, "rtt_ms": list(facts.rtts_ms)},
        "imu_hz": facts.imu_hz,
        "ekf_flags": facts.ekf_flags,
        "origin": facts.origin,
        "latency": {
            "ages_ms": None if d.ages is None else asdict(d.ages),
            "one_way_ms": d.one_way_ms,
            "parameter": d.name,
            "advised": d.advised,
        },
    }


def _change(f: Finding) -> dict[str, Any] | None:
    return None if f.change is None else asdict(f.change)
