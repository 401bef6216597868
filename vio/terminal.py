"""What a person who watches sees on stderr: what is waited for, and how far long work has come."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable


@contextmanager
def waiting(what: str) -> Iterator[None]:
    """Say on stderr what a person who watches is waiting for."""
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextmanager
def progress(total: int, what: str) -> "Iterator[Callable[[], None]]":
    """A progress bar on stderr where a person watches; yields what to call after each step."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda: None
        return
    columns = ("[progress.description]{task.description}", BarColumn(), MofNCompleteColumn())
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda: bar.advance(task)
