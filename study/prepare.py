"""What a run of the pipeline needs before its first notebook: a profile and compiled kernels.

``python -m study.prepare`` is the first stage of ``dvc.yaml`` and always runs. It writes two small files
that every other stage depends on, so that another profile, another Python or another numba reruns the
stages and nothing else does.
"""

from __future__ import annotations

import multiprocessing
import platform
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from functools import cache
from itertools import product

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile

from study.collision._kernels import pose_is_free
from study.errors import StudyError
from study.files import written_whole
from study.paths import output_folder
from study.planners import CuttingForce, IncidenceAngle, PlannerSettings, plan_path
from study.planners.moments import moment, telling_row
from study.planners.planning import DEGREES_OF_FREEDOM, STRATEGIES
from study.profiles import chosen_profile
from study.robots import predict_milling
from study.volumes import LabelVolume


def tiny_volume() -> LabelVolume:
    """Return a block of bone with a target at its top, as small as a 5 mm burr allows."""
    labels = np.zeros((30, 30, 32), np.uint8)
    labels[:, :, :20] = 1
    labels[4:26, 4:26, 8:20] = 2
    return LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), {"air": 0, "protected": 1, "target": 2})


@cache
def load_kernels(strategy: str, dof: int) -> None:
    """Plan something tiny, once a process: the time of the plan after it holds no loading of kernels."""
    plan_path(tiny_volume(), strategy, dof)


def warm_planning(
    strategies: Sequence[str] = STRATEGIES, degrees: Sequence[int] = DEGREES_OF_FREEDOM
) -> None:
    """Compile, or load, what planning, replaying and milling need."""
    for strategy, dof in product(strategies, degrees):
        plan = plan_path(tiny_volume(), strategy=strategy, dof=dof)
        plan.verify()
        predict_milling(plan, density=np.ones(plan.remaining.shape))
        if (strategy, dof) == ("3d", 4):
            state = moment(plan, telling_row(plan))
            pose_is_free(state.shaft, *state.frame.from_indices(state.index[None])[0], state.tilt)


def warm_checks() -> None:
    """Compile the checks of the shaft that nobody calls in planning, and the terms of the fitness."""
    # Imported here and below: a stage that only plans need not load them.
    from study.collision import DirectionCheck, OctreeCheck
    from study.collision.exact._kernels import cylinder_overlaps_box

    volume = tiny_volume()
    terms = (CuttingForce(1.0), IncidenceAngle(1.0))
    plan_path(volume, settings=PlannerSettings(terms=terms))
    check = DirectionCheck(~volume.mask("air"), volume.spacing)
    check.is_free(np.zeros(3), np.array([0.0, -1.0, 0.0]))
    check.window(np.zeros(3), np.zeros(2), np.zeros(2))
    check.remove(np.argwhere(volume.mask("target"))[:1])
    check.refresh()
    cylinder_overlaps_box(np.zeros(3), np.array([0.0, -1.0, 0.0]), 1.0, 0.0, 2.0, np.zeros(3), np.ones(3))
    solid = np.zeros((3, 3, 3), bool)
    solid[1] = True
    OctreeCheck(solid, volume.spacing).met(np.zeros(3), np.array([1.0, 0.0, 0.0]))


@cache
def warm_margins() -> None:
    """Compile, or load, what registration and margins need, once a process."""
    from study.margins import SHAPES, GrowthSettings, grow_margin
    from study.registration import PointRegistration

    model = PointRegistration(20.0 * np.eye(3))
    for method, shape in (("exact", SHAPES[0]), ("exact", SHAPES[1]), ("published", SHAPES[0])):
        settings = GrowthSettings(method, registrations=300, validation_registrations=10)
        grow_margin(tiny_volume(), "target", model, 0.05, shape, settings, rng=0).summary()
    settings = {"registrations": 300, "validation_registrations": 10}
    for method, purpose in (("exact", "remove"), ("published", "remove"), ("exact", "stay_inside")):
        chosen = GrowthSettings.for_removal(method, violation_registrations=300, **settings)
        grow_margin(tiny_volume(), "target", model, 0.05, settings=chosen, rng=0, purpose=purpose).summary()


@cache
def warm_surface() -> None:
    """Compile, or load, what surface registration needs, once a process."""
    from study.registration import register_surface

    corners = np.array([[0.0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]])
    register_surface(corners, corners, np.eye(4)[None])


@cache
def warm_guidance() -> None:
    """Compile, or load, what a guided robot's filters, loop and access need, once a process."""
    from study.guidance import access, filters, fusion
    from study.guidance.blocks import aluminium_block
    from study.guidance.control import PoseController
    from study.guidance.loop import HoleRun
    from study.guidance.setting_up import set_up
    from study.guidance.systems import system

    for room in (fusion, filters, access):
        room.warm()
    PoseController().step(np.eye(4), np.eye(4))
    HoleRun(set_up(system("hannover"), aluminium_block(), rng=0), hole=0, rng=0).run(until_s=0.1)


@cache
def warm_fixtures() -> None:
    """Compile, or load, what virtual fixtures need, once a process."""
    from study import fixtures

    fixtures.warm()


def warm() -> None:
    """Compile every kernel once.

    Processes that fill numba's cache at the same time can break it, so this comes before any worker.
    """
    warm_planning()
    warm_checks()
    warm_margins()
    warm_surface()
    warm_guidance()
    warm_fixtures()


def take_turns(turn: AbstractContextManager) -> None:
    """Let this process add to numba's cache only when no other one does that has the same lock.

    Numba reads the list of what is compiled of a function, appends to it and writes it back: of two
    processes in between, one would be forgotten, or be handed the other's code. What follows here is
    numba's own step; reading needs no turn, because files are replaced whole.

    Parameters
    ----------
    turn : context manager
        A lock that the processes share.
    """
    save = IndexDataCacheFile.save

    def save_in_turn(self: IndexDataCacheFile, key: object, data: object) -> None:
        with turn:
            save(self, key, data)

    IndexDataCacheFile.save = save_in_turn


def _warm_the_other_half(turn: AbstractContextManager) -> None:
    take_turns(turn)
    warm_planning(degrees=DEGREES_OF_FREEDOM[1:])
    warm_guidance()
    warm_fixtures()


def warm_side_by_side() -> None:
    """Compile every kernel once, in two processes that take about as long.

    What both need is compiled by whoever comes to it first, or by both; that costs less than the waiting
    of one.

    Raises
    ------
    StudyError
        If the other process fails.
    """
    context = multiprocessing.get_context("spawn")
    turn = context.Lock()
    other = context.Process(target=_warm_the_other_half, args=(turn,))
    other.start()
    save = IndexDataCacheFile.save
    try:
        take_turns(turn)
        warm_planning(degrees=DEGREES_OF_FREEDOM[:1])
        warm_checks()
        warm_margins()
        warm_surface()
    finally:
        IndexDataCacheFile.save = save
        other.join()
    if other.exitcode:
        raise StudyError(f"the other process that compiles kernels ended with {other.exitcode}")


def main() -> int:
    """Run ``python -m study.prepare``."""
    try:
        profile = chosen_profile()
        warm_side_by_side()
    except StudyError as error:
        print(f"python -m study.prepare: {error}", file=sys.stderr)
        return 2
    figures = output_folder()
    versions = f"Python {platform.python_version()}, numba {numba.__version__}, {platform.machine()}"
    for name, content in (("profile.txt", profile), ("kernels.txt", versions)):
        with written_whole(figures / name) as path:
            path.write_text(content + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
