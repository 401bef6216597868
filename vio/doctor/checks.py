"""All rules over all facts: what is wrong, the worst first."""

from vio.doctor.records import Facts, Finding, Severity
from vio.doctor.rules import (
    ardupilot_parameters,
    base,
    connection,
    delay,
    ports,
    px4_parameters,
    streams,
)
from vio.mavlink.messages import ARDUPILOT

_ORDER = list(Severity)
# what follows where an autopilot drops all of ours: the one word on signing says it better
_DEAF = {"parameters", "timesync_no_answer", "imu_missing"}


def check(facts: Facts) -> list[Finding]:
    """Every finding, errors before warnings before what is good to know."""
    found = [finding for rule in (*connection.RULES, *streams.RULES) for finding in rule(facts)]
    if facts.params:
        found += base.check(param_rules(facts.autopilot), facts)
        found += ports.check(facts)
        found += delay.check(facts)
    elif facts.alive:
        found.append(Finding(Severity.ERROR, "parameters", "no parameter could be read", "nothing"
                             " that is set could be checked", "try again, or by USB"))  # fmt: skip
    if any(finding.code == "signing" for finding in found):
        found = [finding for finding in found if finding.code not in _DEAF]
    return sorted(found, key=lambda f: _ORDER.index(f.severity))


def param_rules(autopilot: int) -> list[base.ParamRule]:
    """The rules on single parameters of an autopilot (MAV_AUTOPILOT)."""
    return ardupilot_parameters.rules() if autopilot == ARDUPILOT else px4_parameters.rules()


def names(autopilot: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Parameters to read: those that must exist, and all others that a rule looks at."""
    home = ardupilot_parameters if autopilot == ARDUPILOT else px4_parameters
    needed = home.NEEDED
    more = [name for rule in param_rules(autopilot) for name in rule.names]
    others = dict.fromkeys([*more, *home.OPTIONAL])
    return needed, tuple(name for name in others if name not in needed)


def failed(findings: list[Finding]) -> bool:
    """Whether anything is an error."""
    return any(f.severity is Severity.ERROR for f in findings)
