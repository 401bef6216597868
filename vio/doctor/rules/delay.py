"""The delay that the autopilot should be told, as measured, against the one that it is told."""

from dataclasses import dataclass

from vio.doctor.records import Change, Facts, Finding, Severity
from vio.mavlink.latency import AgeMeter, Ages, delay_advice
from vio.mavlink.messages import ARDUPILOT

NAMES = {True: "VISO_DELAY_MS", False: "EKF2_EV_DELAY"}
_OFF_MS = 15.0  # 80 ms off cost a factor of two to three in flight; below this nothing is seen
_STARVED_MS = 50.0  # round trips: an autopilot answers within 6, a radio within 50
_EXPIRED_MS = 200.0  # PX4's buffer, and what a pose may be old when it leaves


@dataclass(frozen=True, slots=True)
class Delay:
    """ages: capture to arrival here, None: no poses were heard; one_way_ms: of the link, half of
    the shortest round trip, None: not known; name, advised: what to set, None: not known."""

    name: str
    ages: Ages | None
    one_way_ms: float | None
    advised: float | None


def delay(f: Facts) -> Delay:
    """What was measured, and what follows."""
    meter = AgeMeter()
    for ms in () if f.vision is None else f.vision.ages_ms:
        meter.add(round(ms * 1e6))
    ages, name = meter.ages(), NAMES[f.autopilot == ARDUPILOT]
    one_way = 0.5 * min(f.rtts_ms) if f.rtts_ms else None
    if ages is None:
        return Delay(name, None, one_way, None)
    advice = delay_advice(ages, one_way or 0.0, f.autopilot, f.timesync_asked > 0)
    return Delay(name, ages, one_way, float(advice.split()[-1]))


def words(d: Delay) -> str:
    """One line for a person."""
    link = "unknown" if d.one_way_ms is None else f"{d.one_way_ms:.1f} ms"
    if d.ages is None or d.advised is None:
        then = (
            "is that plus the least age of poses when they leave (the daemon logs it)"
            if d.name == NAMES[True]
            else "is 0 once TIMESYNC is answered: the daemon does, and PX4 then knows capture times"
        )
        return (
            f"latency: no poses are heard on this link, so only the link is measured: {link}"
            f" one way; {d.name} {then}"
        )
    a = d.ages
    return (
        f"latency: capture to here least {a.least:.1f}, p95 {a.p95:.1f} ms, link {link} one way:"
        f" {d.name} {d.advised:g}"
    )


def check(f: Facts) -> list[Finding]:
    """A delay parameter that is off, and poses that come too late for any."""
    d = delay(f)
    out = []
    value = f.params.get(d.name)
    if d.advised is not None and value is not None and abs(value - d.advised) > _OFF_MS:
        out.append(
            Finding(
                Severity.WARNING,
                d.name,
                f"{d.name} is {value:g}, measured are {d.advised:g} ms",
                "a wrong delay makes the vehicle swing: at 80 ms"
                " off the error doubled and hover swung 4 cm",
                f"set {d.name} {d.advised:g}",
                Change(d.name, value, d.advised),
            )
        )
    waits = _own_waits_ms(f)
    if waits > _STARVED_MS:
        out.append(
            Finding(
                Severity.WARNING,
                "doctor_starved",
                f"5 % of this program's round trips take {waits:.0f} ms longer than the least",
                "it is starved here, or the link is: ages of poses are measured that much too old",
                "give the computer some rest, and look again",
            )
        )
    if d.ages is not None and d.ages.p95 - waits > _EXPIRED_MS:
        out.append(
            Finding(
                Severity.ERROR,
                "vision_late",
                f"5 % of the poses are older than {d.ages.p95:.0f} ms",
                "autopilots look back no further than 200 to 250 ms",
                "make images smaller, or use a faster computer",
            )
        )
    return out


def _own_waits_ms(f: Facts) -> float:
    """By how much the slow round trips [ms] exceed the least: what is waited for on our side."""
    if not f.rtts_ms:
        return 0.0
    ordered = sorted(f.rtts_ms)
    return ordered[min(len(ordered) - 1, int(0.95 * len(ordered)))] - ordered[0]
