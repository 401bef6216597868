"""Rules on single parameters: what is right, how bad it is otherwise, why, and what to set."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from vio.doctor.records import Change, Facts, Finding, Severity

_NEAR = 1e-6
_COAST_QUALITY = 30.0  # that ODOMETRY says while coasting


def _always(facts: Facts) -> bool:
    return True


@dataclass(frozen=True, slots=True)
class ParamRule:
    """names: the parameter, then what it is called in other versions; right: whether a value is;
    wanted: what to set; missing: how bad it is where no name exists, None: not at all."""

    names: tuple[str, ...]
    severity: Severity
    why: str
    wanted: float
    right: Callable[[float, Facts], bool] | None = None
    when: Callable[[Facts], bool] = _always
    missing: Severity | None = None
    missing_do: str = ""
    by_hand: bool = False  # never written by --fix

    def holds(self, value: float, facts: Facts) -> bool:
        """Whether a value is right; the wanted one is, where nothing else is said."""
        if self.right is None:
            return abs(value - self.wanted) < _NEAR * max(1.0, abs(self.wanted))
        return self.right(value, facts)


def at_most(limit: float) -> Callable[[float, Facts], bool]:
    """Right up to a limit."""
    return lambda value, facts: value <= limit + _NEAR


def at_least(limit: float) -> Callable[[float, Facts], bool]:
    """Right from a limit on."""
    return lambda value, facts: value >= limit - _NEAR


def one_of(*values: float) -> Callable[[float, Facts], bool]:
    """Right where it is one of these."""
    return lambda value, facts: any(abs(value - v) < _NEAR for v in values)


def bits(mask: int) -> Callable[[float, Facts], bool]:
    """Right where all these bits are set."""
    return lambda value, facts: int(value) & mask == mask


def lets_coasting_pass(value: float, facts: Facts) -> bool:
    """Right up to the quality that our message has while coasting; the other messages have none."""
    return value <= (_COAST_QUALITY if facts.message == "ODOMETRY" else 0.0)


def check(rules: Iterable[ParamRule], facts: Facts) -> list[Finding]:
    """What the rules say of the parameters that were read."""
    found = []
    for rule in rules:
        if not rule.when(facts):
            continue
        name = next((n for n in rule.names if n in facts.params), None)
        if name is None:
            found += _missing(rule, facts)
        elif not rule.holds(facts.params[name], facts):
            found.append(_wrong(rule, name, facts.params[name]))
    return found


def _wrong(rule: ParamRule, name: str, value: float) -> Finding:
    change = None if rule.by_hand else Change(name, value, rule.wanted)
    return Finding(
        rule.severity, name, f"{name} is {value:g}", rule.why, f"set {name} {rule.wanted:g}", change
    )


def _missing(rule: ParamRule, facts: Facts) -> list[Finding]:
    if rule.missing is None or not facts.complete:
        return []
    name = rule.names[0]
    return [Finding(rule.missing, name, f"{name} does not exist", rule.why, rule.missing_do)]
