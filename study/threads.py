"""What runs side by side: threads on the parts of an array, processes of an experiment, stages.

Compiled loops that let go of the interpreter run in threads, all else in processes.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from study.errors import InputError

#: Names how many cores a run may take, in processes or threads: one where notebooks run side by side.
WORKERS_VARIABLE = "STUDY_WORKERS"

#: More threads than this gain little: each fills a memory of answers of its own.
_MOST = 4


def in_threads(work: Callable[[slice], None], count: int, least: int) -> None:
    """Call `work` on slices that together cover ``range(count)``, one a thread.

    Parameters
    ----------
    work : callable
        Of a slice; writes only there, so that the number of threads changes no result.
    count : int
    least : int
        Fewer than this are not worth a thread.
    """
    threads = max(1, min(asked_workers() or _cores(), _MOST, count // least))
    ends = np.linspace(0, count, threads + 1).astype(int)
    pieces = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
    if threads == 1:
        work(pieces[0])
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, pieces))


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def asked_workers() -> int:
    """How many cores a run may take, of `WORKERS_VARIABLE`; 0 if it says nothing.

    Raises
    ------
    InputError
        If the environment asks for anything but a whole number of at least one.
    """
    asked = os.environ.get(WORKERS_VARIABLE)
    if not asked:
        return 0
    if not asked.isdigit() or int(asked) < 1:
        raise InputError(f"{WORKERS_VARIABLE}: expected a number of workers, at least 1, got {asked!r}")
    return int(asked)


def usual_workers() -> int:
    """How many processes, notebooks or stages run at once: as many as asked, else two, one on a single core.

    Raises
    ------
    InputError
        As `asked_workers`.
    """
    return asked_workers() or min(2, os.cpu_count() or 1)
