"""The same experiment again and again, each time with its own calibration, registration and tracker.

What one experiment shows is one draw: a printed table is compared with the spread of many. Each draw has
a seed of its own, so that results do not depend on how many processes share the work.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import GuidanceError, InputError
from study.guidance.blocks import absolute_experiment, lateral_experiment
from study.guidance.drilling import drill_holes
from study.guidance.frames import rigid
from study.guidance.loop import LoopSettings
from study.guidance.scene import Phantom
from study.guidance.setting_up import set_up
from study.guidance.systems import GuidedSystem
from study.registration.rigid import checked_fiducials
from study.registration.sources import checked_vector
from study.threads import usual_workers

#: Fewer experiments than this a process take less time than the process takes to start.
_WORTH_A_PROCESS = 15


@dataclass(frozen=True, eq=False)
class Repeated:
    """What experiments returned, and how many were given up.

    Attributes
    ----------
    values : (n, ...) array
        One row an experiment that ended well, in the order of their seeds.
    aborted : tuple of str
        Why the robot stopped in the others.
    """

    values: np.ndarray
    aborted: tuple[str, ...]


def _lateral(system: GuidedSystem, rng: np.random.Generator, settings: LoopSettings | None) -> np.ndarray:
    result = lateral_experiment(system, rng, settings)
    return np.stack([result.top, result.bottom])


def _absolute(system: GuidedSystem, rng: np.random.Generator, settings: LoopSettings | None) -> np.ndarray:
    result = absolute_experiment(system, rng, settings)
    return np.stack([result.target_distance, result.axis_distance])


def _tip(
    system: GuidedSystem, rng: np.random.Generator, settings: LoopSettings | None, phantom: Phantom
) -> np.ndarray:
    ready = set_up(system, phantom, rng, imaged=True)
    (hole,) = drill_holes(ready, rng, settings)
    return np.stack([hole.error_at(0.0), hole.bottom - (hole.entry + hole.length * hole.direction)])


def _some(
    experiment: Callable[..., np.ndarray],
    system: GuidedSystem,
    settings: LoopSettings | None,
    drawn: bool,
    seeds: Sequence[np.random.SeedSequence],
) -> list[np.ndarray | str]:
    """Experiments with these seeds; the message of those that were given up."""
    done: list[np.ndarray | str] = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        try:
            done.append(experiment(system.drawn(rng) if drawn else system, rng, settings))
        except GuidanceError as stopped:
            done.append(str(stopped))
    return done


def repeated(
    experiment: Callable[..., np.ndarray],
    system: GuidedSystem,
    count: int,
    rng: object = 0,
    drawn: bool = False,
    settings: LoopSettings | None = None,
    workers: int | None = None,
) -> Repeated:
    """Run an experiment many times.

    Parameters
    ----------
    experiment : callable
        Of a system, a generator and settings; returns an array. A function of a module: it goes to processes.
    system : GuidedSystem
    count : int
    rng : int or numpy.random.SeedSequence
        Its children are the experiments' seeds.
    drawn : bool
        Whether each experiment draws the causes that are not known anew, `GuidedSystem.drawn`.
    settings : LoopSettings, optional
    workers : int, optional
        Processes; by default what the environment allows, see `study.threads.usual_workers`.

    Raises
    ------
    InputError
        If the count, or the number of workers, is not a positive whole number, or `rng` is a generator.
    GuidanceError
        If every experiment was given up.
    """
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise InputError(f"count: expected a whole number of at least 1, got {count!r}")
    if workers is not None and (isinstance(workers, bool) or not isinstance(workers, int) or workers < 1):
        raise InputError(f"workers: expected a whole number of at least 1, got {workers!r}")
    if isinstance(rng, np.random.Generator):
        raise InputError("rng: expected a seed, which tells the experiments' own, got a generator")
    seeds = rng if isinstance(rng, np.random.SeedSequence) else np.random.SeedSequence(rng)
    # Fresh, so that asking twice draws the same.
    children = np.random.SeedSequence(seeds.entropy, spawn_key=seeds.spawn_key).spawn(count)
    work = partial(_some, experiment, system, settings, drawn)
    workers = min(usual_workers() if workers is None else workers, max(1, count // _WORTH_A_PROCESS))
    if workers == 1:
        done = work(children)
    else:
        pieces = [children[k::workers] for k in range(workers)]
        context = multiprocessing.get_context("spawn")
        done = [None] * count
        with ProcessPoolExecutor(workers, mp_context=context) as pool:
            for k, some in enumerate(pool.map(work, pieces)):
                done[k::workers] = some
    values = [one for one in done if not isinstance(one, str)]
    aborted = tuple(one for one in done if isinstance(one, str))
    if not values:
        raise GuidanceError(f"all {count} experiments were given up; the first: {aborted[0]}")
    return Repeated(np.stack(values), aborted)


def repeat_lateral(system: GuidedSystem, count: int, rng: object = 0, **how: object) -> Repeated:
    """Aluminium blocks: values (n, 2, 24, 2), top and bottom, holes, x and y in mm; see `repeated`."""
    return repeated(_lateral, system, count, rng, **how)


def repeat_absolute(system: GuidedSystem, count: int, rng: object = 0, **how: object) -> Repeated:
    """Acrylic blocks: values (n, 2, 6), distance of targets and of axes, holes, mm; see `repeated`."""
    return repeated(_absolute, system, count, rng, **how)


def on_the_table(name: str, spheres: ArrayLike, entry: ArrayLike, target: ArrayLike) -> Phantom:
    """Anatomy with one planned hole, laid so that the hole points down before the robot.

    Parameters
    ----------
    name : str
    spheres : (n, 3) array
        Bone anchors or markers to register by, image frame, mm.
    entry, target : (3,) arrays
        Of the hole, image frame, mm.

    Raises
    ------
    InputError
        If the spheres do not fix a pose or the hole has no length.
    """
    spheres = checked_fiducials("spheres", spheres)
    entry, target = checked_vector("entry", entry, "mm"), checked_vector("target", target, "mm")
    length = np.linalg.norm(target - entry)
    if not length > 0:
        raise InputError(f"entry, target: expected two places, got {entry.tolist()} twice")
    down = Rotation.align_vectors([[0.0, 0.0, -1.0]], [(target - entry) / length])[0]
    place = np.array([450.0, 0.0, 180.0]) - down.apply(entry)
    return Phantom(name, spheres, entry, target, rigid(down, place))


def tip_errors(
    system: GuidedSystem,
    count: int,
    spheres: ArrayLike,
    entry: ArrayLike,
    target: ArrayLike,
    rng: object = 0,
    **how: object,
) -> Repeated:
    """How far the drill misses a planned line, at its entry and at its end: one hole an experiment.

    Parameters
    ----------
    system : GuidedSystem
    count : int
        Of experiments, each with its own tracker, arm, calibration and registration.
    spheres, entry, target
        See `on_the_table`.
    rng, **how
        See `repeated`.

    Returns
    -------
    Repeated
        Values (n, 2, 3): centre of the hole at the entry, and the tip at the end, minus the plan; image
        frame, mm. Along the line the first is 0.
    """
    phantom = on_the_table("planned access", spheres, entry, target)
    return repeated(partial(_tip, phantom=phantom), system, count, rng, **how)
