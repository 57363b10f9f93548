"""How long planning takes: compilation apart, then both strategies on bones and on an undercut target.

With 4 and 5 degrees of freedom, the latter by both methods. Run with ``python benchmarks/planning.py
[volume files]``. Without files the real bones are used when they are there, else two of the procedural
specimens. The printed times (means a specimen on eight cores, tables A.1 to A.4) stand beside ours.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
import pandas as pd

from study.cases import undercut
from study.errors import IncompletePlanWarning
from study.planners import PlannerSettings, plan_path
from study.published import summary
from study.robots import predict_milling
from study.volumes import LabelVolume, read_volume

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "temporal_bone"
#: Strategy, degrees of freedom, method, and the table that prints the time of the first two.
VARIANTS = (
    ("3d", 4, "exact", "A.2"),
    ("zigzag", 4, "exact", "A.1"),
    ("3d", 5, "exact", "A.4"),
    ("zigzag", 5, "exact", "A.3"),
    ("3d", 5, "published", "A.4"),
    ("zigzag", 5, "published", "A.3"),
)
FIRST_CALL = """
import time
from benchmarks.planning import cases
volume = cases([])[0][1]
from study.planners import plan_path
for dof in (4, 5):
    for strategy in ("3d", "zigzag"):
        clock = time.perf_counter()
        plan_path(volume, strategy, dof)
        print(f"{strategy} {dof} DOF {time.perf_counter() - clock:.1f} s", end="; ")
"""


def cases(files: list[str]) -> list[tuple[str, LabelVolume]]:
    """What to plan on: (name, volume)."""
    if files:
        return [(Path(file).stem, read_volume(file)) for file in files]
    bones = sorted(REAL.glob("*/planning_0p38.nrrd"))
    if bones:
        return [(bone.parent.name, read_volume(bone)) for bone in bones]
    from study.specimens import specimen

    return [(name, specimen(name).planning) for name in ("CH01", "TB03")]


def best_of(runs: int, work, enough_s: float = 15.0) -> tuple[float, float, object]:
    """Least and median seconds of a call, and its result; fewer runs once `enough_s` has passed."""
    seconds = []
    while len(seconds) < runs and sum(seconds) < enough_s:
        clock = time.perf_counter()
        result = work()
        seconds.append(time.perf_counter() - clock)
    return min(seconds), float(np.median(seconds)), result


def main(files: list[str]) -> None:
    with tempfile.TemporaryDirectory() as fresh:
        environment = os.environ | {"NUMBA_CACHE_DIR": fresh, "PYTHONPATH": str(ROOT)}
        for label in ("first calls, compiling", "first calls, kernels cached"):
            out = subprocess.run(
                [sys.executable, "-c", FIRST_CALL],
                env=environment,
                cwd=ROOT,
                capture_output=True,
                text=True,
                check=True,
            )
            print(f"{label}: {out.stdout}")
    warnings.simplefilter("ignore", IncompletePlanWarning)  # what is left stands in the table
    rows = []
    volumes = cases(files)
    volumes.append((f"{volumes[0][0]} undercut", undercut(volumes[0][1])))
    for name, volume in volumes:
        for strategy, dof, method, table in VARIANTS:
            settings = PlannerSettings(method=method)
            least, median, plan = best_of(
                5, lambda v=volume, a=(strategy, dof, None, settings): plan_path(v, *a)
            )
            replay, _, _ = best_of(1, plan.verify)
            printed = summary(table).loc["mean", "simulation_time_s"]
            rows.append(
                {
                    "volume": name,
                    "plan": f"{strategy} {dof} DOF" + (f", {method}" if dof == 5 else ""),
                    "modified_target_cm3": plan.summary()["modified_initial_target_cm3"],
                    "inaccessible_voxels": int((plan.modified.target & ~plan.accessible).sum()),
                    "left_voxels": int(plan.left.sum()),
                    "target_left_percent": 100 * plan.summary()["unmodified_final_over_initial_ratio"],
                    "milling_s": predict_milling(plan).time_s,
                    "path_m": plan.length_mm / 1000,
                    "plan_best_s": least,
                    "plan_median_s": median,
                    "printed_s": printed,
                    "printed_over_ours": printed / least,
                    "verify_s": replay,
                }
            )
    print(pd.DataFrame(rows).to_string(index=False, float_format=lambda x: f"{x:.3f}"))


if __name__ == "__main__":
    main(sys.argv[1:])
