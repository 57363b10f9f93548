"""Whether a tip ever enters: random steps among hard meshes, measured by libraries that no fixture uses.

Run with ``python benchmarks/fixture_safety.py [--steps 100000] [--meshes NAME ...] [--out FILE.csv]``. A
random hand presses tips against eight meshes, among them a real temporal bone of 1.7 million triangles and
its decimation to a hundred thousand when the real data is there (``STUDY_REAL_DATA``). After the run three
libraries look at it:

- VTK: unsigned distance of the centre to the triangles, after a third, two thirds and all of every step, and
  for the point also whether the line of every step crosses a triangle;
- coal: distance of the whole line of a step to the triangles, for half of the constrained steps;
- embree: parity of a ray from the end of every step, where the mesh is closed.

The control is what the hand asked for at the constrained steps, by VTK.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pandas as pd
import trimesh

from study.experiments import fixture_meshes as meshes
from study.experiments.fixture_distances import THIN_MM, CapsuleDistance
from study.experiments.fixture_validation import ENTERED_MM, HandSettings, Surface, Wander, wander
from study.fixtures import SphereTool
from study.volumes import read_volume, surface

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "temporal_bone" / "RT143"
RADII = (0.5, 1.0, 2.5, 0.0)
PITCH_MM = 0.19
KEPT = 100_000
PARTS = (1 / 3, 2 / 3, 1.0)
COAL_PART = 0.5
MADE = ("plate", "wall", "spikes", "fan", "rough", "flipped")


def real_bone() -> meshes.Mesh:
    """The surface of the bone of a real case."""
    volume = read_volume(REAL / "labels_0p38.nrrd")
    name = next(name for name, label in volume.names.items() if label == 1)
    mesh = surface(volume, name, 0.2, PITCH_MM)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def cases(names: list[str]) -> Iterator[Surface]:
    """What to push against; the made-up bone in place of the real one where that is absent."""
    if not names or {"bone", "decimated"} & set(names):
        if REAL.exists():
            bone, origin = real_bone(), "RT143"
        else:
            bone, origin = meshes.bone(), "CH01"
            print(f"no real bone at STUDY_REAL_DATA ({REAL.name} is missing): specimen {origin} in its place")
        if not names or "bone" in names:
            yield Surface(f"bone {origin}", bone, bone, True)
        if not names or "decimated" in names:
            less = meshes.decimated(bone, 1 - KEPT / len(bone[1]))
            yield Surface(f"bone {origin}, decimated", less, less, False)
    rough = meshes.rough()
    made = {
        "plate": (meshes.plate(), None, False),
        "wall": (meshes.wall(), None, True),
        "spikes": (meshes.spikes(), None, False),
        "fan": (meshes.fan(), None, False),
        "rough": (rough, None, True),
        "flipped": (meshes.flipped(rough), rough, True),
    }
    for name, (mesh, even, closed) in made.items():
        if not names or name in names:
            yield Surface(name, mesh, mesh if even is None else even, closed)


class LineDistance(CapsuleDistance):
    """Distance of a line, all of the way of a step, to a mesh by coal."""

    def __init__(self, mesh: meshes.Mesh) -> None:
        super().__init__(mesh, np.zeros((0, 7)))

    def along(self, start: np.ndarray, motion: np.ndarray) -> float:
        """Least distance of the line from a start over a motion, mm."""
        self._bodies = [self._placed(np.r_[start, start + motion, 0.0])]
        return self(np.zeros(3))


def report(case: Surface, radius: float, steps: int, seed: int, line: LineDistance) -> dict:
    """One row: a tip pushed against a mesh, and what the libraries say."""
    tool, other = SphereTool(radius), case.other
    least = max(radius, 0.0)
    clock = time.perf_counter()
    run: Wander = wander(case, tool, "exact", steps, seed, HandSettings())
    walked = time.perf_counter() - clock
    met = np.flatnonzero(run.statuses == "constrained")
    rng = np.random.default_rng(seed)
    gaps = np.array([other.distances(run.poses + part * run.motions).min() - least for part in PARTS])
    ends = run.poses + run.motions
    crossed = 0
    if radius == 0.0:
        crossed = sum(other.crosses(x, y) for x, y in zip(run.poses, ends, strict=True))
    some = met[rng.random(len(met)) < COAL_PART]
    swept = np.array([line.along(run.poses[k], run.motions[k]) for k in some]) - least
    inside = -1
    if case.closed and radius > 0:
        vertices, faces = case.even
        body = trimesh.Trimesh(vertices, faces, process=False)
        inside = int(trimesh.ray.ray_pyembree.RayMeshIntersector(body).contains_points(ends).sum())
    wanted = run.poses[met] + run.desired[met]
    if radius > 0:
        asked = other.distances(wanted) - radius
        entered, deepest = int((asked < -ENTERED_MM).sum()), float(-asked.min())
    else:
        entered = sum(other.crosses(run.poses[k], x) for k, x in zip(met, wanted, strict=True))
        deepest = np.nan
    return {
        "mesh": case.name,
        "triangles": len(case.mesh[1]),
        "edges_of_3_or_more": int((case.fixture.mesh.adjacency.edge_counts > 2).sum()),
        "radius_mm": radius,
        "steps": steps,
        "constrained": len(met),
        "stopped": int(run.stopped.sum()),
        "clipped": int(run.clipped.sum()),
        "vtk_least_um": 1e3 * gaps.min(),
        "vtk_entered": int((gaps < -ENTERED_MM).sum()),
        "crossed": crossed,
        "coal_steps": len(some),
        "coal_least_um": 1e3 * swept.min() if len(swept) else np.nan,
        "embree_inside": inside,
        "control_entered": entered,
        "control_worst_mm": deepest,
        "walk_s": walked,
        "all_s": time.perf_counter() - clock,
    }


def main() -> None:
    """Print a row for each mesh and tip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--meshes", nargs="*", default=[], choices=("bone", "decimated", *MADE))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    options = parser.parse_args()
    print(f"coal {coal.__version__}, a segment of radius {THIN_MM:g} mm; entered: by {ENTERED_MM:g} mm")
    rows = []
    for case in cases(options.meshes):
        line = LineDistance(case.even)
        for radius in RADII:
            rows.append(report(case, radius, options.steps, options.seed, line))
            print(
                ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items())
            )
            if options.out:
                pd.DataFrame(rows).to_csv(options.out, index=False)
    table = pd.DataFrame(rows)
    print(table.to_string(index=False, float_format=lambda v: f"{v:.4g}"))
    bad = table["vtk_entered"].sum() + table["crossed"].sum() + table["embree_inside"].clip(lower=0).sum()
    bad += int((table["coal_least_um"] < -1e3 * ENTERED_MM).sum())
    print(f"{bad} penetrations by more than {1e3 * ENTERED_MM:g} micrometre in {table['steps'].sum()} steps")
    raise SystemExit(1 if bad or not (table["control_entered"] > 0).any() else 0)


if __name__ == "__main__":
    main()
