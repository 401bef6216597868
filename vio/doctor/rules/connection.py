"""Rules on the link: whether it lives, its MAVLink version, its clocks, who else talks on it."""

from collections.abc import Callable

from vio.doctor.records import Change, Facts, Finding, Severity
from vio.mavlink.messages import ARDUPILOT, PX4

E, W, I = Severity.ERROR, Severity.WARNING, Severity.INFO  # noqa: E741
CONVERGES = 500  # answers after which PX4 believes its TIMESYNC, ten a second
_PX4_RTT_MS = 10.0  # PX4 throws longer round trips away
_DRIFT = 1e-3
_TWO_ANSWER = "PX4 does not look who answers: two clocks get mixed, and vision stops after 50 s"


def silence(f: Facts) -> list[Finding]:
    """The autopilot stopped talking."""
    if f.alive:
        return []
    return [
        Finding(
            E,
            "silent",
            "the autopilot has fallen silent",
            "no heartbeat for 3.5 s: what is said below is incomplete",
            "look at cable, power and baud rate",
        )
    ]


def version(f: Facts) -> list[Finding]:
    """MAVLink 1."""
    if not f.version_1:
        return []
    do = (
        "set SERIALn_PROTOCOL 2 of this port" if f.autopilot == ARDUPILOT else "set MAV_PROTO_VER 2"
    )
    return [
        Finding(
            E,
            "mavlink_1",
            "the autopilot speaks MAVLink 1 on this link",
            "covariance and"
            " reset counter of our poses are MAVLink 2: as 1 they read 0, and every jump is"
            " taken for motion",
            do,
        )
    ]


def signing(f: Facts) -> list[Finding]:
    """What is heard is signed, and nothing is answered."""
    if not f.signed or f.rtts_ms or f.params:
        return []
    return [
        Finding(
            E,
            "signing",
            "the autopilot signs its messages and answers none of ours",
            "with MAVLink 2 signing on it drops all that is not signed with its key",
            "set mavlink.signing.key_file to its key, or switch its signing off",
        )
    ]


def incomplete(f: Facts) -> list[Finding]:
    """Not all parameters came."""
    if f.complete:
        return []
    return [
        Finding(
            W,
            "parameters",
            "not every parameter could be read",
            "too much is lost on this link: what was not read was not checked",
            "try again, or by USB",
        )
    ]


def asking(f: Facts) -> list[Finding]:
    """PX4 asks for our clock, and how far it has come."""
    if f.autopilot != PX4 or not f.alive:
        return []
    if f.timesync_asked == 0:
        normal = [
            n
            for n in range(3)
            if f.params.get(f"MAV_{n}_CONFIG") and f.params.get(f"MAV_{n}_MODE") == 0
        ]
        change = Change(f"MAV_{normal[0]}_MODE", 0.0, 2.0) if len(normal) == 1 else None
        name = f"MAV_{normal[0]}_MODE" if normal else "MAV_x_MODE"
        return [
            Finding(
                E,
                "timesync_not_asked",
                "PX4 does not ask for our time (TIMESYNC)",
                "it then stamps our poses when they arrive, not when they were taken; ports"
                " in mode normal never ask",
                f"set {name} 2 (onboard)",
                change,
            )
        ]
    if f.timesync_asked < 0.5 * 10.0 * f.seconds:
        return [
            Finding(
                W,
                "timesync_seldom",
                f"PX4 asks for our time {f.timesync_asked / f.seconds:.1f}"
                " times a second instead of 10",
                "it needs 500 answers to believe our stamps",
                "look for losses on the link",
            )
        ]
    if f.timesync_asked < CONVERGES:
        return [
            Finding(
                I,
                "timesync_converging",
                f"PX4 has had {f.timesync_asked} answers of the"
                f" {CONVERGES} that it needs to believe our stamps",
                "until then (50 s from its start) it takes a pose for as old as its way here",
            )
        ]
    return []


def round_trips(f: Facts) -> list[Finding]:
    """TIMESYNC both ways."""
    if not f.alive:
        return []
    if not f.rtts_ms:
        return [
            Finding(
                W,
                "timesync_no_answer",
                "the autopilot does not answer TIMESYNC",
                "its IMU stamps cannot be brought into our clock",
                "a router may filter it; an old firmware may not know it",
            )
        ]
    slow = sum(r > _PX4_RTT_MS for r in f.rtts_ms) / len(f.rtts_ms)
    if f.autopilot == PX4 and slow > 0.1:
        return [
            Finding(
                E if slow > 0.5 else W,
                "timesync_slow",
                f"{slow * 100:.0f} % of TIMESYNC round trips take more than 10 ms",
                "PX4 throws these away, and after 10 in a row begins anew",
                "use a faster line (921600 baud), fewer streams, no radio",
            )
        ]
    return []


def clock(f: Facts) -> list[Finding]:
    """A clock that drifts or steps."""
    out = []
    if f.clock_steps:
        out.append(
            Finding(
                W,
                "clock_step",
                f"the autopilot's clock has stepped {f.clock_steps} times",
                "IMU samples around a step are dropped",
                "did it restart? Do two senders answer TIMESYNC?",
            )
        )
    if abs(f.drift) > _DRIFT:
        out.append(
            Finding(
                I,
                "clock_drift",
                f"the autopilot's clock runs {f.drift * 100:+.2f} % against ours",
                "it is followed; simulators do so, boards do not",
            )
        )
    return out


def company(f: Facts) -> list[Finding]:
    """Others on the same link."""
    out = []
    if f.responders:
        out.append(
            Finding(
                E if f.autopilot == PX4 else I,
                "two_responders",
                f"{', '.join(f.responders)} answers TIMESYNC, too",
                _TWO_ANSWER if f.autopilot == PX4 else "two senders of poses may be at work",
                "let one alone answer (mavros: timesync plugin off)",
            )
        )
    if f.others:
        out.append(
            Finding(
                I,
                "others",
                f"other companions on this link: {', '.join(f.others)}",
                "only one may send poses and answer TIMESYNC",
            )
        )
    return out


RULES: tuple[Callable[[Facts], list[Finding]], ...] = (
    silence,
    version,
    signing,
    incomplete,
    asking,
    round_trips,
    clock,
    company,
)
