"""What runs side by side: threads on the halves of an array, and how many processes an experiment starts.

Compiled loops that let go of the interpreter run in threads, all else in processes.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from study.errors import InputError

#: Names how many processes an experiment starts unless it is told: one where notebooks run side by side.
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
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    threads = max(1, min(usable, _MOST, count // least))
    ends = np.linspace(0, count, threads + 1).astype(int)
    pieces = [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
    if threads == 1:
        work(pieces[0])
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, pieces))


def usual_workers() -> int:
    """How many processes an experiment starts: of `WORKERS_VARIABLE`, else two, or one on a single core.

    Raises
    ------
    InputError
        If the environment asks for anything but a whole number of at least one.
    """
    asked = os.environ.get(WORKERS_VARIABLE)
    if not asked:
        return min(2, os.cpu_count() or 1)
    if not asked.isdigit() or int(asked) < 1:
        raise InputError(f"{WORKERS_VARIABLE}: expected how many processes, at least 1, got {asked!r}")
    return int(asked)
