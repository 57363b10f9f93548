"""How long safety margins take: five structures of a bone, one sweep beside the printed growth.

Run with ``python benchmarks/margins.py [case folders] [--published-fine]``. Without folders the real bones
are used when they are there, else two of the procedural specimens. Each bone is taken on its coarse grid
(about 0.4 mm) and a fine one (its native one, or upsampled to 0.2 mm). The printed growth is run for every
structure on the coarse grid; on the fine one only for the facial nerve, since it takes minutes, unless
``--published-fine`` is given. Printed times (means of five specimens on six cores, table 3.2) stand beside
ours. Validation on as many fresh registrations is part of every time.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from study.errors import InputError
from study.margins import ACCEPTABLE_RISKS, SHAPES, GrowthSettings, SafetyMargin, grow_margin
from study.registration import PointRegistration
from study.specimens import read_temporal_bone_case, specimen, structure_mask
from study.volumes import LabelVolume, resampled

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "temporal_bone"
PRINTED_MINUTES = {"coarse": 3.85, "fine": 108.70}  # table 3.2, spatially varying
REPEATS = 5
FIRST_CALL = """
import time
from study.prepare import tiny_volume
from study.margins import grow_margin
from study.registration import PointRegistration
clock = time.perf_counter()
grow_margin(tiny_volume(), "target", PointRegistration([[20, 0, 0], [0, 20, 0], [0, 0, 20]]), 0.05)
print(f"{time.perf_counter() - clock:.1f} s")
"""


def cases(folders: list[str]) -> Iterator[tuple[str, str, LabelVolume, np.ndarray]]:
    """Name, grid, anatomy and fiducials of what to grow margins on."""
    found = [Path(folder) for folder in folders] or sorted(path.parent for path in REAL.glob("*/case.json"))
    for folder in found:
        for grid, labels in (("coarse", "labels_0p38.nrrd"), ("fine", "labels_native.nrrd")):
            case = read_temporal_bone_case(folder, labels=labels)
            yield case.name, grid, case.anatomy, case.fiducials
    if not found:
        for name in ("CH01", "TB03"):
            bone = specimen(name)
            yield name, "coarse", bone.anatomy, bone.fiducials
            yield name, "fine", resampled(bone.anatomy, 0.2), bone.fiducials


def timed(anatomy: LabelVolume, fiducials: np.ndarray, structure: str, shape: str, repeats: int, **settings):
    """Best and median seconds of growing a margin, and the margin."""
    mask = structure_mask(anatomy, structure)
    model = PointRegistration(fiducials)
    seconds = []
    for seed in range(repeats):
        margin = grow_margin(
            anatomy,
            mask,
            model,
            ACCEPTABLE_RISKS[structure],
            shape,
            GrowthSettings(**settings),
            rng=seed,
            name=structure,
        )
        seconds.append(margin.time_s)
    return min(seconds), float(np.median(seconds)), margin


def row(margin: SafetyMargin, best: float, median: float, **more: object) -> dict[str, object]:
    """One line of the table."""
    low, high = margin.validation.interval
    return {
        **more,
        "voxels": margin.voxels,
        "mm3": margin.volume_mm3,
        "risk": margin.damage_risk,
        "validated risk": f"{margin.validation.risk:.5f} [{low:.5f}, {high:.5f}]",
        "best s": best,
        "median s": median,
    }


def main() -> int:
    """Print the tables."""
    fine_too = "--published-fine" in sys.argv
    folders = [word for word in sys.argv[1:] if not word.startswith("-")]
    with tempfile.TemporaryDirectory() as empty:
        environment = {**os.environ, "NUMBA_CACHE_DIR": empty}
        run = subprocess.run(
            [sys.executable, "-c", FIRST_CALL], env=environment, capture_output=True, text=True, check=True
        )
    print("first margin in a fresh checkout, compilation included:", run.stdout.strip())
    rows = []
    for name, grid, anatomy, fiducials in cases(folders):
        for shape in SHAPES:
            total = 0.0
            for structure in ACCEPTABLE_RISKS:
                more = {"bone": name, "grid": grid, "shape": shape, "structure": structure}
                try:
                    best, median, margin = timed(anatomy, fiducials, structure, shape, REPEATS)
                except InputError as error:
                    print(f"{name} {grid} {structure}: skipped, {error}")
                    continue
                total += best
                rows.append(row(margin, best, median, method="exact", **more))
                slow = grid == "coarse" or structure == "facial_nerve" or fine_too
                if slow and shape == SHAPES[0]:
                    printed, _, margin = timed(anatomy, fiducials, structure, shape, 1, method="published")
                    rows.append(row(margin, printed, printed, method="published", **more))
                    print(
                        f"{name} {grid} {structure}: one sweep {best:.3f} s, printed growth {printed:.1f} s "
                        f"({len(margin.history)} looks): {printed / best:.0f} times as long",
                        flush=True,
                    )
            print(
                f"{name} {grid} {shape}: five structures {total:.2f} s (printed {PRINTED_MINUTES[grid]} min)",
                flush=True,
            )
    with pd.option_context("display.width", 200, "display.max_columns", 20, "display.max_rows", 200):
        print(pd.DataFrame(rows).round(4).to_string(index=False))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
