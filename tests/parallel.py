"""Tests on several workers (``pytest -n 2``, as `make test` has it): what goes where, and each its kernels.

pytest-xdist starts a process for each worker. Tests of one file stay together, since they share what
their fixtures planned. The notebooks are the exception: only those that read what another one made need
its folder, so each such chain of stages is a group of its own. They come first, as the longest.
"""

import os
import shutil
import tempfile
from functools import cache
from pathlib import Path

import yaml

from study import _compiled
from study.paths import PROJECT
from study.threads import WORKERS_VARIABLE

NOTEBOOKS = "test_notebooks.py"


def chains(stages):
    """Name of the chain that each stage of ``dvc.yaml`` belongs to: that of its first stage.

    `prepare` is left out: every stage waits for it, and it makes no table.
    """
    maker = {
        path: name for name in stages if name != "prepare" for out in stages[name]["outs"] for path in out
    }
    chain = {}
    for name in stages:
        if name != "prepare":
            read = {chain[maker[path]] for path in stages[name]["deps"] if path in maker}
            chain[name] = min(read, key=list(stages).index, default=name)
            chain |= {other: chain[name] for other, first in chain.items() if first in read}
    return chain


@cache
def chain_of_stage():
    return chains(yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["stages"])


def group(nodeid):
    """What stays on one worker with this test: its file, or for a notebook its chain of stages."""
    file, _, test = nodeid.partition("::")
    if Path(file).name == NOTEBOOKS:
        stage = test.partition("[")[2].rstrip("]")
        return f"{file}, {chain_of_stage().get(stage, '')}"
    return file


def turn(item):
    """Sort key of the order in which groups are given out."""
    return item.path.name != NOTEBOOKS


def give_caches(config, specs):
    """Give each worker compiled kernels, and IPython's history, in a folder that nobody else writes.

    Processes that fill numba's cache at the same time can break it. Hence everything is compiled once,
    here, and each worker starts from a copy. What tests compile beyond that goes to the copy, which goes
    away at the end. Notebooks and other processes that a test starts take over their worker's folder, and
    its one core.
    """
    from study.prepare import warm_side_by_side  # imports all of the package: a single test need not wait

    warm_side_by_side()
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(chosen) if chosen else Path(_compiled.__file__).parent / "__pycache__"
    writable = os.access(base, os.W_OK)
    folder = tempfile.mkdtemp(prefix="workers-", dir=base if writable else None)
    config.add_cleanup(lambda: shutil.rmtree(folder, ignore_errors=True))
    for spec in specs:
        own = Path(folder, spec.id)
        own.mkdir()
        for kernels in base.glob("kernels-*"):
            half_written = shutil.ignore_patterns("*.tmp.*")
            shutil.copytree(kernels, own / kernels.name, ignore=half_written, copy_function=_link)
        spec.env |= {"NUMBA_CACHE_DIR": str(own), "IPYTHONDIR": str(own / "ipython"), WORKERS_VARIABLE: "1"}


def _link(source, target):
    # As good as a copy: numba never writes into a file, it puts a new one in its place.
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def scheduler(config, log):
    """Groups in the order of collection, each to the worker that is free first."""
    from xdist.scheduler import LoadScopeScheduling

    class Groups(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            return group(nodeid)

    config.option.loadscopereorder = False  # else by the number of tests, which says nothing about time
    return Groups(config, log)
