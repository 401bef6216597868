"""What a reader of another system's log found, in our terms."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from tagvo.camera.model import Camera
from tagvo.geometry import IntArray
from tagvo.records import Frame
from vio.records import ImuTrack, Truth

Step = Callable[[], None]


def said(err: BaseException) -> str:
    """What an exception of another's library says, at most 160 characters on one line."""
    try:
        text = " ".join(str(err).split())
    except Exception:  # such as str() of a giant number
        text = ""
    return text[:160] or type(err).__name__


@dataclass(frozen=True, slots=True, eq=False)
class FrameReel:
    """The frames of a log, read when asked for: total is how many there are at most."""

    total: int
    open: Callable[[], Iterator[Frame]]


@dataclass(frozen=True, slots=True, eq=False)
class Foreign:
    """The content of one or several files of another system.

    imus: by the name that they get in a flight log; noted_ns: by the same name, arrivals that were
    noted in another clock than the stamps', (n,); truth of I in W; notes: what a person must know;
    rectified: pixels are of rectified images; image_topic: of a bag's images.
    """

    imus: Mapping[str, ImuTrack] = field(default_factory=dict)
    noted_ns: Mapping[str, IntArray] = field(default_factory=dict)
    truth: Truth | None = None
    camera: Camera | None = None
    frames: FrameReel | None = None
    notes: tuple[str, ...] = ()
    rectified: bool = False
    image_topic: str | None = None
