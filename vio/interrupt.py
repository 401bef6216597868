"""Lets Ctrl-C reach Python: the AprilTag library takes it away while it searches an image.

It sets the signal back to its default, which ends the process at once and loses all results. So
the signal is blocked in every thread, and one thread waits for it: that bypasses any handler.
A KeyboardInterrupt may strike anywhere, inside compiled code too; `gently` lets a loop end itself.
"""

import _thread
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_gentle, _asked = threading.Event(), threading.Event()


@contextmanager
def interruptible() -> Iterator[None]:
    """Within it Ctrl-C is a KeyboardInterrupt in the main thread, whatever libraries do.

    To be entered before libraries start threads of their own: those inherit what is blocked.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    ended = threading.Event()

    def watch() -> None:
        while signal.sigwait({signal.SIGINT}) and not ended.is_set():
            if _gentle.is_set() and not _asked.is_set():
                _asked.set()
            else:
                _thread.interrupt_main()

    watcher = threading.Thread(target=watch, name="ctrl-c", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        signal.pthread_kill(watcher.ident or 0, signal.SIGINT)
        watcher.join()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def gently() -> Iterator[Callable[[], bool]]:
    """Within it the first Ctrl-C only makes the yielded question true; a second one interrupts."""
    _asked.clear()
    _gentle.set()
    try:
        yield _asked.is_set
    finally:
        _gentle.clear()
