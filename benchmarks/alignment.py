"""How often, how closely and how fast a swab is aligned with its kidney from no start.

Run with ``python benchmarks/alignment.py [case folders] [--rotations 200]``. Without folders the real
kidneys are used when they are there, and the procedural ones always. Every swab is turned by uniform random
rotations and moved by some hundred millimetres; for the procedural kidneys fresh digitiser noise is added
each time, since the outcome for one swab hardly depends on how it was moved. Errors are root mean square
distances of the swab's points, and the distance at the tumour's centroid, from the known transform.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.registration import align_surface
from study.specimens import kidney_case, kidney_catalogue, read_kidney_case

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "kidney"
NOISE = 0.3  # mm per axis


def tried(case, rotations: int, noise: float, name: str) -> dict[str, object]:
    """One row: a case's swab, moved at random and aligned again."""
    rng = np.random.default_rng(0)
    anatomy = case.anatomy
    tumour = np.argwhere(anatomy.labels == anatomy.names["tumour"]).mean(axis=0)
    tumour = anatomy.affine[:3, :3] @ tumour + anatomy.affine[:3, 3]
    errors, at_tumour, ratios, wall, cpu, converged = [], [], [], [], [], []
    surface = case.surface
    _ = surface.vertex_normals  # the mesh makes them once
    for n in range(rotations):
        turn, shift = Rotation.random(random_state=rng).as_matrix(), rng.normal(0, 300, 3)
        swab = (case.swab + rng.normal(0, noise, case.swab.shape)) @ turn.T + shift
        clocks = time.perf_counter(), time.process_time()
        found = align_surface(surface, swab, rng=n)
        wall.append(time.perf_counter() - clocks[0])
        cpu.append(time.process_time() - clocks[1])
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = turn, shift
        back = found.transform @ motion
        off = case.swab @ back[:3, :3].T + back[:3, 3] - case.swab
        errors.append(np.sqrt((off**2).sum(axis=1).mean()))
        at_tumour.append(np.linalg.norm(back[:3, :3] @ tumour + back[:3, 3] - tumour))
        ratios.append(found.ratio)
        converged.append(found.converged)
    return {
        "case": name,
        "vertices": len(surface.vertices),
        "within_1_mm": np.mean(np.array(errors) < 1),
        "worst_mm": max(errors),
        "tumour_within_1_mm": np.mean(np.array(at_tumour) < 1),
        "tumour_worst_mm": max(at_tumour),
        "converged": np.mean(converged),
        "rms_mm": found.rms,
        "least_ratio": min(ratios),
        "median_s": np.median(wall),
        "median_cpu_s": np.median(cpu),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--rotations", type=int, default=200)
    asked = parser.parse_args()
    folders = asked.folders or sorted(path.parent for path in REAL.glob("*/case.json"))
    rows = []
    for folder in folders:
        rows.append(tried(read_kidney_case(folder), asked.rotations, 0.0, folder.name))
        print(pd.DataFrame(rows[-1:]).round(3).to_string(index=False), flush=True)
    for name in kidney_catalogue():
        rows.append(tried(kidney_case(name), asked.rotations, NOISE, name))
        print(pd.DataFrame(rows[-1:]).round(3).to_string(index=False), flush=True)
    print(pd.DataFrame(rows).round(3).to_string(index=False))


if __name__ == "__main__":
    main()
