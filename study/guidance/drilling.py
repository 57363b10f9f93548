"""Drill the holes of a phantom with the whole loop running."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from study.errors import GuidanceError
from study.guidance.loop import DrilledHole, HoleRun, LoopSettings
from study.guidance.safety import Status
from study.guidance.setting_up import SetUp


def drill_holes(
    ready: SetUp,
    rng: object = None,
    settings: LoopSettings | None = None,
    holes: Sequence[int] | None = None,
) -> list[DrilledHole]:
    """Drill a phantom's holes one after the other with one arm.

    Parameters
    ----------
    ready : SetUp
    rng : anything `numpy.random.default_rng` takes
    settings : LoopSettings, optional
    holes : sequence of int, optional
        All by default.

    Raises
    ------
    ReachError
        If the arm cannot take a pose.
    GuidanceError
        If the robot stopped, which it should not without faults.
    """
    rng = np.random.default_rng(rng)
    done = []
    for hole in range(len(ready.phantom.entries)) if holes is None else holes:
        run = HoleRun(ready, hole, rng, settings)
        if run.run() is not Status.DONE:
            raise GuidanceError(
                f"hole {hole}: expected to end as DONE, it is {run.status.name} at {run.time_s:.2f} s"
            )
        done.append(run.result)
    return done
