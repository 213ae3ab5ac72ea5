"""Progress bars on standard error for long work; silent where standard error is not a terminal."""

from collections.abc import Iterator, Sequence
from typing import TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

T = TypeVar("T")
console = Console(stderr=True)


def track(work: Sequence[T], description: str) -> Iterator[T]:
    """Iterate over `work` with a bar that shows how much is done and how long the rest will take."""
    bar = Progress(
        TextColumn("{task.description:<34}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    with bar:
        yield from bar.track(work, description=description)


def say(message: str) -> None:
    """One line of what is going on."""
    console.print(message, highlight=False, markup=False)
