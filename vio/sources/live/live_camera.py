"""The live camera: a thread that grabs, the latest frame for whoever takes it, and its return."""

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable

from tagvo.detect.protocol import gray_image
from tagvo.records import Frame
from vio.errors import CameraLost, SourceError
from vio.sources.live.grab import Grabber, Shot

LOG = logging.getLogger("vio.camera")
_BACK_OFF_S = (0.2, 0.5, 1.0, 2.0, 5.0)


class Latest:
    """Holds frames for one taker; where it is slow the newest win and the others are counted."""

    def __init__(self, size: int = 1) -> None:
        self._frames: list[Frame] = []
        self._size = size
        self._ready = threading.Condition()
        self._closed = False
        self.dropped = 0

    def put(self, frame: Frame) -> None:
        """Offer a frame."""
        with self._ready:
            self._frames.append(frame)
            while len(self._frames) > self._size:
                self._frames.pop(0)
                self.dropped += 1
            self._ready.notify()

    def take(self) -> Frame | None:
        """The oldest frame held, waited for; None: there will be no more."""
        with self._ready:
            self._ready.wait_for(lambda: self._frames or self._closed)
            return self._frames.pop(0) if self._frames else None

    def close(self) -> None:
        """There will be no more; what is held may still be taken."""
        with self._ready:
            self._closed = True
            self._ready.notify_all()


class LiveCamera:
    """Grabs in a thread of its own; a camera that goes is opened anew, for ever, with back-off.

    counters: frames, camera_lost, camera_returned, camera_stamp_guessed, camera_backward;
    present: whether the camera gives frames; ended: the files that stand for a camera are at their
    end.
    """

    def __init__(
        self,
        open_it: Callable[[], Grabber],
        hand_on: Callable[[Frame], None],
        say: Callable[[str, bool], None],
    ) -> None:
        """say(text, bad): tells the ground that the camera has gone or is back."""
        self._open, self._hand_on, self._say = open_it, hand_on, say
        self._grabber: Grabber | None = None
        self.counters: Counter[str] = Counter()
        self.present, self.ended = True, threading.Event()
        self._before_ns: int | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._live, name="camera", daemon=True)

    def start(self) -> None:
        """Begin to grab."""
        self._thread.start()

    def stop(self, timeout_s: float = 1.0) -> None:
        """End the thread; a driver that does not answer is left behind."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout_s)

    def _live(self) -> None:
        tries = 0
        while not self._stop.is_set():
            try:
                if self._grabber is None:
                    self._grabber = self._open()
                shot = self._grabber.read()
                if shot is None:
                    break
                tries = 0
                self._take(shot)
            except (CameraLost, SourceError, OSError) as err:
                self._close()
                self._gone(str(err))
                self._stop.wait(_BACK_OFF_S[min(tries, len(_BACK_OFF_S) - 1)])
                tries += 1
            except Exception:  # a driver's whim must not end the camera of a vehicle in the air
                LOG.exception("the camera goes on after a fault")
                self.counters["camera_faults"] += 1
                self._close()
                self._stop.wait(0.5)
        self._close()
        self.ended.set()

    def _take(self, shot: Shot) -> None:
        arrival = time.monotonic_ns()
        if not self.present:
            self.present = True
            self.counters["camera_returned"] += 1
            LOG.info("the camera is back")
            self._say("camera is back", False)
        self.counters["frames"] += 1
        if not shot.exact:
            if not self.counters["camera_stamp_guessed"]:
                LOG.warning("the driver's stamps are not in the monotonic clock: arrival is taken")
            self.counters["camera_stamp_guessed"] += 1
        if self._before_ns is not None and shot.t_ns <= self._before_ns:
            self.counters["camera_backward"] += 1
            return
        self._before_ns = shot.t_ns
        image = gray_image(shot.image)
        self._hand_on(Frame(shot.t_ns, image, arrival_ns=arrival, received_ns=arrival))

    def _gone(self, why: str) -> None:
        if not self.present:
            return
        self.present = False
        self.counters["camera_lost"] += 1
        LOG.warning("%s: the camera has gone; trying again", why)
        self._say("camera lost", True)

    def _close(self) -> None:
        grabber, self._grabber = self._grabber, None
        if grabber is None:
            return
        try:
            grabber.close()
        except Exception as err:
            LOG.warning("closing the camera: %s", err)
