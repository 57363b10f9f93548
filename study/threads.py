"""Halves of an array for two threads: compiled loops that let go of the interpreter run side by side."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

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
