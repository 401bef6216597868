"""What every section of a scenario is: frozen, finite numbers, no key that nobody reads."""

from typing import Annotated, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, NonNegativeFloat


class Model(BaseModel):
    """A section of a scenario; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] > value[1]:
        raise ValueError("a range [least, most] is needed")
    return value


Range: TypeAlias = Annotated[tuple[NonNegativeFloat, NonNegativeFloat], AfterValidator(_ordered)]
