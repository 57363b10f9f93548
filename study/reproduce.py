"""The pipeline with its stages side by side: ``python -m study.reproduce`` instead of ``dvc repro``.

A notebook spends its first seconds on one core, loading libraries, and dvc runs one stage after the
other. Here each stage is still dvc's, which alone decides whether it is up to date, but as many run at
once as there are workers, none before those whose outputs it reads. They start in the order of ``dvc.yaml``.
In the full profile loading is nothing beside computing: one stage at a time takes all cores.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path

import yaml

from study.errors import InputError, StudyError
from study.paths import PROJECT
from study.profiles import chosen_profile
from study.threads import WORKERS_VARIABLE, usual_workers


def read_stages(file: Path = PROJECT / "dvc.yaml") -> dict[str, set[str]]:
    """Return which stages each stage has to wait for.

    Parameters
    ----------
    file : pathlib.Path
        A dvc pipeline.

    Returns
    -------
    dict of str to set of str
        Of each stage those whose outputs it depends on, in the order of the file.
    """
    stages = yaml.safe_load(file.read_text(encoding="utf-8"))["stages"]

    def paths(stage: Mapping, key: str) -> set[str]:
        return {path for item in stage.get(key, []) for path in ([item] if isinstance(item, str) else item)}

    maker = {path: name for name, stage in stages.items() for path in paths(stage, "outs")}
    return {
        name: {maker[path] for path in paths(stage, "deps") if path in maker}
        for name, stage in stages.items()
    }


def run_in_order(stages: Mapping[str, set[str]], run: Callable[[str], int], workers: int) -> list[str]:
    """Run stages, several at once, none before those that it waits for.

    Parameters
    ----------
    stages : mapping of str to set of str
        As `read_stages` returns it.
    run : callable
        Of a stage's name; returns 0 if it succeeded. Called from threads.
    workers : int
        Stages at the same time.

    Returns
    -------
    list of str
        Stages that failed. After the first no other one begins.

    Raises
    ------
    InputError
        If stages wait for each other.
    """
    waiting, done, failed = dict(stages), set(), []
    running: dict[Future[int], str] = {}
    with ThreadPoolExecutor(workers) as pool:
        while waiting or running:
            ready = [name for name in waiting if waiting[name] <= done and not failed]
            for name in ready[: workers - len(running)]:
                del waiting[name]
                running[pool.submit(run, name)] = name
            if not running:
                break
            for finished in wait(running, return_when=FIRST_COMPLETED).done:
                name = running.pop(finished)
                if finished.result() == 0:
                    done.add(name)
                else:
                    failed.append(name)
    if waiting and not failed:
        raise InputError(f"expected stages that can follow each other, {', '.join(waiting)} cannot")
    return failed


def run_stage(name: str, workers: int = 0, folder: Path = PROJECT) -> int:
    """Let dvc run one stage, if it is not up to date.

    Parameters
    ----------
    name : str
        Of the stage.
    workers : int
        Cores that it may take; 0 leaves it to `study.threads`.
    folder : pathlib.Path
        Where ``dvc.yaml`` is.

    Returns
    -------
    int
        The exit code of dvc.
    """
    # One dvc at a time reads and writes dvc.lock; while a stage's command runs, the next one can.
    command = [sys.executable, "-m", "dvc", "--wait-for-lock", "repro", "--single-item", name]
    asked = {WORKERS_VARIABLE: str(workers)} if workers else {}
    return subprocess.run(command, cwd=folder, env={**os.environ, **asked}).returncode


def main() -> int:
    """Run ``python -m study.reproduce``; return 1 if a stage failed, 2 if the profile is not one."""
    try:
        together = 1 if chosen_profile() == "full" else usual_workers()
        cores = 0 if together == 1 else 1
        failed = run_in_order(read_stages(), lambda name: run_stage(name, cores), together)
    except StudyError as error:
        print(f"python -m study.reproduce: {error}", file=sys.stderr)
        return 2
    if failed:
        print(f"python -m study.reproduce: failed: {', '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
