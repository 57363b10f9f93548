"""How long planning takes: compilation apart, then 3-D and zigzag on bones and on an undercut target.

Run with ``python benchmarks/planning.py [volume files]``. Without files the real bones are used when
they are there, else one of the procedural specimens. The published times (653 s and 133 s a specimen
on eight cores, table 2.2) stand beside ours.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd

from study.cases import undercut
from study.planners import plan_path
from study.published import summary
from study.robots import predict_milling
from study.volumes import LabelVolume, read_volume

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "temporal_bone"
FIRST_CALL = """
import time
from benchmarks.planning import cases
volume = cases([])[0][1]
from study.planners import plan_path
clock = time.perf_counter()
plan_path(volume, "3d")
print(time.perf_counter() - clock)
plan_path(volume, "zigzag")
print(time.perf_counter() - clock)
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


def best_of(runs: int, work) -> tuple[float, float, object]:
    """Least and median seconds of a call, and its result."""
    seconds = []
    for _ in range(runs):
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
            three_d, both = (float(line) for line in out.stdout.split())
            print(f"{label}: 3-D {three_d:.1f} s, then zigzag {both - three_d:.1f} s")
    rows = []
    volumes = cases(files)
    volumes.append((f"{volumes[0][0]} undercut", undercut(volumes[0][1])))
    for name, volume in volumes:
        for strategy in ("3d", "zigzag"):
            least, median, plan = best_of(5, lambda v=volume, s=strategy: plan_path(v, s))
            replay, _, _ = best_of(1, plan.verify)
            rows.append(
                {
                    "volume": name,
                    "strategy": strategy,
                    "modified_target_cm3": plan.summary()["modified_initial_target_cm3"],
                    "inaccessible_voxels": int((plan.modified.target & ~plan.accessible).sum()),
                    "left_voxels": int(plan.left.sum()),
                    "target_left_percent": 100 * plan.summary()["unmodified_final_over_initial_ratio"],
                    "milling_s": predict_milling(plan).time_s,
                    "path_m": plan.length_mm / 1000,
                    "plan_best_s": least,
                    "plan_median_s": median,
                    "verify_s": replay,
                }
            )
    print(pd.DataFrame(rows).to_string(index=False, float_format=lambda x: f"{x:.3f}"))
    for name in ("A.1", "A.2"):
        printed = summary(name)
        seconds = printed.loc["mean", "simulation_time_s"]
        print(f"printed simulation time, table {name}: {seconds} s a specimen")


if __name__ == "__main__":
    main(sys.argv[1:])
