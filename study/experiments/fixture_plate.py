"""A tip that slides along a plate and is pressed on it: what is left of the length asked for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.experiments import fixture_meshes as meshes
from study.experiments.fixture_validation import ENTERED_MM, METHODS
from study.fixtures import Controller, MeshFixture, SphereTool


def plate_progress(
    presses: Sequence[float] = (0.0, 0.01, 0.1, 0.2),
    counts: Sequence[int] = (4, 30, 100),
    methods: Sequence[str] = METHODS,
    cycles: int = 30,
    courses: int = 4,
    radius: float = 1.0,
    along_mm: float = 0.1,
    seed: int = 0,
) -> pd.DataFrame:
    """Slide a tip along a plate while pressing on it.

    Parameters
    ----------
    presses : sequence of float
        mm a cycle, into the plate.
    counts : sequence of int
        Vertices along an edge of the plate, of 24 mm.
    methods : sequence of str
    cycles, courses : int
        Cycles of a course, and courses in random directions from random places.
    radius, along_mm : float
        Of the tip, and asked for along the plate in a cycle, mm.
    seed : int

    Returns
    -------
    pandas.DataFrame
        Columns plate ("even", "10 % turned round"), vertices (along an edge), press_mm, method,
        progress_ratio (length along the plate in the commanded direction, over what was asked for) and
        worst_mm.
    """
    rows = []
    for kind in ("even", "10 % turned round"):
        for count in counts:
            mesh = meshes.plate(count, 24.0, seed)
            if kind != "even":
                mesh = meshes.flipped(mesh)
            fixture = MeshFixture(mesh, "plate")
            for press in presses:
                for method in methods:
                    rng = np.random.default_rng(seed)
                    control = (
                        None if method == "none" else Controller([fixture], SphereTool(radius), method=method)
                    )
                    given, lowest = 0.0, np.inf
                    for _ in range(courses):
                        angle = rng.uniform(0, 2 * np.pi)
                        course = np.array([np.cos(angle), np.sin(angle), 0.0])
                        x = np.r_[rng.uniform(-3, 3, 2), radius + ENTERED_MM]
                        desired = along_mm * course - [0, 0, press]
                        for _ in range(cycles):
                            motion = desired if control is None else control.step(x, desired).motion
                            x = x + motion
                            given += motion @ course
                            lowest = min(lowest, x[2])
                    rows.append(
                        {
                            "plate": kind,
                            "vertices": count,
                            "press_mm": press,
                            "method": method,
                            "progress_ratio": given / (along_mm * cycles * courses),
                            "worst_mm": max(0.0, radius - lowest),
                        }
                    )
    return pd.DataFrame(rows)
