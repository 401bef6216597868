"""What the paper printed: configs/reproduce.yaml."""

from dataclasses import dataclass
from typing import Any

from tagvo.errors import ConfigError
from tagvo.textfile import read_yaml
from vio.config.shipped import config_path


@dataclass(frozen=True, slots=True)
class Printed:
    """Mean and standard deviation of e_p [cm] and of e_o [deg], None where none was printed."""

    e_p_cm: tuple[float, float]
    e_o_deg: tuple[float, float]


class PaperTables:
    """The paper's figures by study, case, phase and estimator."""

    def __init__(self) -> None:
        data: dict[str, Any] = read_yaml(config_path("reproduce.yaml"), ConfigError)
        self._figures: dict[tuple[str, str, str, str], Printed] = {}
        static, columns = data["static"], data["columns"]
        for place, row in static["e_p_cm"].items():
            turned = static["e_o_deg"][place]
            for arm, p, o in zip(columns, row, turned, strict=True):
                self._figures["static", f"HR {place}", place, arm] = _printed(p, o)
        for flight, part in data["flights"].items():
            for vehicle, arms in part["e_p_cm"].items():
                for arm, row in arms.items():
                    turned = part["e_o_deg"][vehicle][arm]
                    for phase, p, o in zip(part["phases"], row, turned, strict=True):
                        key = ("flights", f"{vehicle} {flight}", phase, arm)
                        self._figures[key] = _printed(p, o)

    def get(self, study: str, case: str, phase: str, arm: str) -> Printed | None:
        """The figures of one cell; None where the paper has none."""
        return self._figures.get((study, case, phase, arm))

    def __len__(self) -> int:
        return len(self._figures)


def _printed(p: list[float], o: list[float]) -> Printed:
    return Printed((p[0], p[1]), (o[0], o[1]))
