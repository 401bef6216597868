"""The errors that vio raises on purpose; with tagvo's own they are all that the CLI prints bare."""


class VioError(Exception):
    """A known error: its text says where, what came and what is allowed."""


class LogError(VioError):
    """A flight log cannot be used."""


class EvaluationError(VioError):
    """Two trajectories cannot be compared."""


class SimulationError(VioError):
    """A scenario cannot be flown, or its log cannot be written."""
