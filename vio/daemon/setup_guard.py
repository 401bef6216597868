"""The set-up check of a flight: judged beside the loop, said to all, and LOST while disarmed."""

import logging
import threading
from collections.abc import Callable
from typing import Any

from vio.setup_check.findings import SHORT, Finding

LOG = logging.getLogger("vio.daemon")


class SetupGuard:
    """Takes what the check finds and makes words, an alarm and a reason to be LOST of it.

    alarm(name, text) and say(text, bad) are a Bridge's; armed: asked at every sample.
    """

    def __init__(
        self,
        alarm: Callable[[str, str | None], None],
        say: Callable[[str, bool], None],
        armed: Callable[[], bool],
    ) -> None:
        self._alarm, self._say, self._armed = alarm, say, armed
        self._said: set[tuple[str, bool]] = set()
        self._reasons: tuple[str, ...] = ()
        self._busy = threading.Lock()
        self.findings: list[Finding] = []

    def found(self, findings: list[Finding]) -> None:
        """Take the findings as they stand now; each is said once."""
        self.findings = findings
        for finding in findings:
            key = (finding.code, finding.certain)
            if key in self._said:
                continue
            self._said.add(key)
            LOG.log(logging.ERROR if finding.certain else logging.WARNING, "%s", finding.text)
            if not finding.certain:
                self._say(f"set-up: {SHORT[finding.code]}?", True)
        certain = [f.code for f in findings if f.certain]
        self._alarm("setup", f"set-up: {SHORT[certain[0]]}" if certain else None)
        self._reasons = tuple(f"setup_{code}" for code in certain)

    def blame(self) -> tuple[str, ...]:
        """Why the filter is LOST now: a set-up beyond doubt, while the vehicle is disarmed."""
        return () if not self._reasons or self._armed() else self._reasons

    def later(self, job: Callable[[], None]) -> None:
        """Run a judgement beside the loop; one at a time, others are left out."""
        if not self._busy.acquire(blocking=False):
            return

        def work() -> None:
            try:
                job()
            except Exception:
                LOG.exception("the set-up check goes on after a fault")
            finally:
                self._busy.release()

        threading.Thread(target=work, name="set-up check", daemon=True).start()

    def status(self) -> list[dict[str, Any]]:
        """The findings for the status file."""
        return [finding.plain() for finding in self.findings]
