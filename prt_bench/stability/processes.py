"""Cells and mutants spread over processes. What they are, and how they are judged, is elsewhere."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TypeVar

from prt_bench.errors import SpecError
from prt_bench.progress import track

Task = TypeVar("Task")
Answer = TypeVar("Answer")


def spread(
    work: Callable[[Task], Answer], tasks: Sequence[Task], description: str, jobs: int | None = 1, progress: bool = True
) -> Iterator[Answer]:
    """`work` on every task, in order, with a bar: in this process, or in `jobs` new ones (None: as many as there are cores).

    `work` is a function of a module and tasks and answers can be pickled, unless `jobs` is 1. What is compiled or cached is
    so in each process. When the iterator is left early, tasks that have not begun are dropped. Raises `SpecError` for fewer
    jobs than one.
    """
    if jobs is not None and jobs < 1:
        raise SpecError(f"there must be at least 1 job, not {jobs}")
    jobs = min(jobs or os.cpu_count() or 1, max(len(tasks), 1))
    if jobs == 1:
        yield from map(work, track(tasks, description) if progress else tasks)
        return
    executor = ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))  # a fork would inherit XLA's locked threads
    try:
        futures = [executor.submit(work, task) for task in tasks]
        yield from (future.result() for future in (track(futures, description) if progress else futures))
    finally:
        executor.shutdown(cancel_futures=True)
