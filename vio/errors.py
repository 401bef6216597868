"""The errors that vio raises on purpose; with tagvo's own they are all that the CLI prints bare."""


class VioError(Exception):
    """A known error: its text says where, what came and what is allowed."""


class LogError(VioError):
    """A flight log cannot be used."""


class EvaluationError(VioError):
    """Two trajectories cannot be compared."""


class LinkError(VioError):
    """A link to a flight controller cannot be had, or what is at its end is not known."""


class SourceError(VioError):
    """A camera cannot be used as configured."""


class CameraLost(SourceError):
    """A camera gives no images; it may come back."""


class SimulationError(VioError):
    """A scenario cannot be flown, or its log cannot be written."""
