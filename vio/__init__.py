"""Time, inertia and vehicle around tagvo: the localizer, logs, judgement; this is public.

Names are loaded when they are first used, so that `import vio` costs next to nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from vio.config import Config as Config
    from vio.config import load_config as load_config
    from vio.errors import EvaluationError as EvaluationError
    from vio.errors import LogError as LogError
    from vio.errors import VioError as VioError
    from vio.evaluate.compare import comparison as comparison
    from vio.evaluate.records import Trajectory as Trajectory
    from vio.filter.eskf import ErrorStateFilter as ErrorStateFilter
    from vio.localize.localizer import Localizer as Localizer
    from vio.localize.run import run as run
    from vio.records import ImuSample as ImuSample
    from vio.records import NavState as NavState
    from vio.records import Truth as Truth
    from vio.sinks.tum import read_tum as read_tum
    from vio.sinks.tum import write_tum as write_tum
    from vio.sources.flight_log.log import FlightLog as FlightLog

_HOME = {
    "Config": "config",
    "ErrorStateFilter": "filter.eskf",
    "EvaluationError": "errors",
    "FlightLog": "sources.flight_log.log",
    "ImuSample": "records",
    "Localizer": "localize.localizer",
    "LogError": "errors",
    "NavState": "records",
    "Trajectory": "evaluate.records",
    "Truth": "records",
    "VioError": "errors",
    "comparison": "evaluate.compare",
    "load_config": "config",
    "read_tum": "sinks.tum",
    "run": "localize.run",
    "write_tum": "sinks.tum",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'vio' has no attribute {name!r}")
    return getattr(import_module(f"vio.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})
