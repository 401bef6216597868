"""Counts what was skipped while reading, by cause, and keeps the first example of each."""

from collections.abc import Iterable


class Tally:
    """Faults that were met and survived; `counters` and `warnings` may grow while a log is read."""

    def __init__(self) -> None:
        self.counters: dict[str, int] = {}
        self._first: dict[str, str] = {}
        self._notes: list[str] = []

    def count(self, cause: str, example: str, n: int = 1) -> None:
        """Add n faults of one cause; the first example of a cause is kept."""
        if n > 0:
            self.counters[cause] = self.counters.get(cause, 0) + n
            self._first.setdefault(cause, example)

    def note(self, text: str) -> None:
        """Keep a warning that has no count."""
        self._notes.append(text)

    @property
    def warnings(self) -> list[str]:
        """One line a note and one a cause, with its first example and its number."""
        return self._notes + list(self._lines())

    def _lines(self) -> Iterable[str]:
        for cause, example in self._first.items():
            n = self.counters[cause]
            yield f"{example} ({cause}: {n})"
