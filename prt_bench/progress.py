"""Progress bars on standard error for long work; silent where standard error is not a terminal."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

T = TypeVar("T")
console = Console(stderr=True)


def _bar(*more: ProgressColumn) -> Progress:
    return Progress(
        TextColumn("{task.description:<34}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        *more,
        console=console,
        disable=not console.is_terminal,
    )


def track(work: Sequence[T], description: str) -> Iterator[T]:
    """Iterate over `work` with a bar that shows how much is done and how long the rest will take."""
    with _bar() as bar:
        yield from bar.track(work, description=description)


@contextmanager
def meter(description: str, total: int) -> Iterator[Callable[[int, str], None]]:
    """A bar for work that tells how it goes: the function it gives takes how much of `total` is done, and a remark."""
    with _bar(TextColumn("{task.fields[remark]}")) as bar:
        task = bar.add_task(description, total=total, remark="")
        yield lambda done, remark: bar.update(task, completed=done, remark=remark)


def say(message: str) -> None:
    """One line of what is going on."""
    console.print(message, highlight=False, markup=False)
