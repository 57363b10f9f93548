"""How long surface registrations take, beside small_gicp's point-to-point ICP on the same data.

Run with ``python benchmarks/surface_registration.py [case folders]``. Without folders the real kidneys are
used when they are there, and always the procedural K1. Every case is registered from 5000 starts (5 mm, 5
degrees) until it has converged; small_gicp (``pip install -e .[benchmarks]``) gets some of the same starts,
the same points and the same tolerances in the same run: in one process a core, which is how it is quickest,
and, for comparison, one start after the other on its own threads.

The two need not end at the same place: ICP on vertices has many fixed points close together, small_gicp
takes Gauss-Newton steps, and ours are by default the best fit in closed form. So the table says how often
both end at the same place if ours take "its step" too, how often as they are, and how often the place where
one ended is a fixed point of the other, which it does not leave. A busy machine shows in the seconds; the
ratio of both programs' processor time is less disturbed.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.spatial import cKDTree

from study.prepare import warm_surface
from study.registration import IcpSettings, SurfaceFits, SurfaceRegistration, SurfaceTree, register_surface
from study.specimens import KidneyCase, kidney_case, read_kidney_case

try:
    import small_gicp
except ImportError:
    small_gicp = None

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "kidney"
STARTS = 5000
PEER_STARTS = 500
OWN_THREADS_STARTS = 40
REPEATS = 3
SAME = 0.01  # mm, largest distance between the same swab point in two results
STOPPING = {
    "default": IcpSettings(),
    "looser": IcpSettings(translation_tolerance=1e-3, rotation_tolerance=1e-4),
    "published": IcpSettings.published(),
}


def cases(folders: list[str]) -> Iterator[KidneyCase]:
    """Kidneys to register."""
    found = [Path(folder) for folder in folders] or sorted(path.parent for path in REAL.glob("*/case.json"))
    if not found:
        print(f"no real kidney: none in {REAL} (set STUDY_REAL_DATA)")
    for folder in found:
        yield read_kidney_case(folder)
    if not folders:
        yield kidney_case("K1")


def cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Peer:
    """small_gicp on one kidney. Its steps turn about the origin, which is therefore put into the swab."""

    def __init__(self, vertices: np.ndarray, swab: np.ndarray) -> None:
        self.there = np.eye(4)
        self.there[:3, 3] = swab.mean(axis=0)
        self.back = np.linalg.inv(self.there)
        self.target = small_gicp.PointCloud(vertices - self.there[:3, 3])
        self.source = small_gicp.PointCloud(swab - self.there[:3, 3])
        self.tree = small_gicp.KdTree(self.target)

    def fit(self, starts: np.ndarray, settings: IcpSettings, threads: int = 1) -> np.ndarray:
        """(n, 4, 4) results, one start after the other."""
        out = []
        for start in starts:
            found = small_gicp.align(
                self.target,
                self.source,
                self.tree,
                init_T_target_source=self.back @ start @ self.there,
                registration_type="ICP",
                max_correspondence_distance=1e6,
                num_threads=threads,
                max_iterations=settings.max_iterations,
                rotation_epsilon=settings.rotation_tolerance,
                translation_epsilon=settings.translation_tolerance,
            )
            out.append(self.there @ found.T_target_source @ self.back)
        return np.array(out)


_peer: Peer | None = None


def _begin(vertices: np.ndarray, swab: np.ndarray) -> None:
    global _peer
    _peer = Peer(vertices, swab)


def _work(task: tuple[np.ndarray, IcpSettings]) -> tuple[np.ndarray, float]:
    clock = time.process_time()
    return _peer.fit(*task), time.process_time() - clock


@dataclass
class Run:
    """Results of some starts and what they took: seconds by the clock, and of all cores together."""

    transforms: np.ndarray
    seconds: float
    cpu: float
    fits: SurfaceFits | None = None


def run_ours(tree: SurfaceTree, swab: np.ndarray, starts: np.ndarray, settings: IcpSettings) -> Run:
    clock, cpu = time.perf_counter(), time.process_time()
    fits = register_surface(tree, swab, starts, settings)
    return Run(fits.transforms, time.perf_counter() - clock, time.process_time() - cpu, fits)


def run_peer(pool, starts: np.ndarray, settings: IcpSettings) -> Run:
    """On a process a core, which has everything ready."""
    pieces = [(piece, settings) for piece in np.array_split(starts, min(len(starts), 8 * cores()))]
    clock = time.perf_counter()
    transforms, cpu = zip(*pool.map(_work, pieces, chunksize=1), strict=True)
    return Run(np.concatenate(transforms), time.perf_counter() - clock, sum(cpu))


def apart(a: np.ndarray, b: np.ndarray, swab: np.ndarray) -> np.ndarray:
    """Largest distance between the same swab point under two transforms, mm, for many pairs."""
    turn, shift = (a - b)[:, :3, :3], (a - b)[:, :3, 3]
    return np.linalg.norm(swab @ turn.transpose(0, 2, 1) + shift[:, None], axis=2).max(axis=1)


def alone(case: KidneyCase, model: SurfaceRegistration) -> Iterator[dict[str, object]]:
    """What all starts take at each stopping, and registrations as `SurfaceRegistration` draws them."""
    tree, starts = SurfaceTree.of(model.vertices), model.starts(STARTS, 0)
    about = {"kidney": case.name, "vertices": len(model.vertices), "points": len(model.swab)}
    for name, settings in STOPPING.items():
        runs = [run_ours(tree, model.swab, starts, settings) for _ in range(REPEATS)]
        yield {**about, "stopping": name, **_line(runs)}
    clock, cpu = time.perf_counter(), time.process_time()
    fits = model.register(STARTS, 0)
    drawn = Run(fits.transforms, time.perf_counter() - clock, time.process_time() - cpu, fits)
    yield {**about, "stopping": "default, noise and resampling", **_line([drawn])}


def _line(runs: list[Run]) -> dict[str, object]:
    fits = runs[0].fits
    return {
        "best s": min(run.seconds for run in runs),
        "median s": float(np.median([run.seconds for run in runs])),
        "cpu s": min(run.cpu for run in runs),
        "iterations": fits.iterations.mean(),
        "most": fits.iterations.max(),
        "converged": fits.converged.mean(),
        "rms mm": fits.rms.mean(),
    }


def beside_peer(case: KidneyCase, model: SurfaceRegistration) -> Iterator[dict[str, object]]:
    """Rates of both on the same starts, taken in turns, and where both end."""
    tree, swab, starts = SurfaceTree.of(model.vertices), model.swab, model.starts(PEER_STARTS, 0)
    for name, settings in STOPPING.items():
        peer, few = Peer(model.vertices, swab), starts[:OWN_THREADS_STARTS]
        clock = time.perf_counter()
        peer.fit(few, settings, threads=cores())
        own_threads = len(few) / (time.perf_counter() - clock)
        with multiprocessing.get_context("spawn").Pool(cores(), _begin, (model.vertices, swab)) as pool:
            run_peer(pool, few, settings)
            both = [
                (run_ours(tree, swab, starts, settings), run_peer(pool, starts, settings))
                for _ in range(REPEATS)
            ]
            ours, theirs = both[0]
            stays = run_peer(pool, ours.transforms, settings)
        back = run_ours(tree, swab, theirs.transforms, settings)
        same_step = run_ours(tree, swab, starts, replace(settings, step="gauss_newton"))
        distance = apart(ours.transforms, theirs.transforms, swab)
        yield {
            "kidney": case.name,
            "stopping": name,
            "ours /s": PEER_STARTS / min(one.seconds for one, _ in both),
            "small_gicp /s": PEER_STARTS / min(other.seconds for _, other in both),
            "its threads /s": own_threads,
            "ratio": float(np.median([other.seconds / one.seconds for one, other in both])),
            "ratio cpu": min(other.cpu for _, other in both) / min(one.cpu for one, _ in both),
            "agree, its step": (apart(same_step.transforms, theirs.transforms, swab) < SAME).mean(),
            "agree": (distance < SAME).mean(),
            "99 % within mm": float(np.quantile(distance, 0.99)),
            "its end fixed": (apart(back.transforms, theirs.transforms, swab) < SAME).mean(),
            "our end fixed": (apart(stays.transforms, ours.transforms, swab) < SAME).mean(),
            "our rms mm": ours.fits.rms.mean(),
            "its rms mm": rms(tree, swab, theirs.transforms),
        }


def rms(tree: SurfaceTree, swab: np.ndarray, transforms: np.ndarray) -> float:
    """Mean over results of the RMS distance to the nearest vertices, mm."""
    search = cKDTree(tree.vertices)
    each = [search.query(swab @ t[:3, :3].T + t[:3, 3])[0] for t in transforms]
    return float(np.sqrt((np.array(each) ** 2).mean(axis=1)).mean())


def main() -> int:
    """Print the tables."""
    folders = [word for word in sys.argv[1:] if not word.startswith("-")]
    clock = time.perf_counter()
    warm_surface()
    print(f"kernels compiled or loaded in {time.perf_counter() - clock:.1f} s; {cores()} cores")
    if small_gicp is None:
        print("no comparison: small_gicp is not installed (pip install -e .[benchmarks])")
    speed, peers = [], []
    for case in cases(folders):
        model = SurfaceRegistration(case.surface, case.swab)
        for line in alone(case, model):
            speed.append(line)
            print(f"{case.name}, {line['stopping']}: {STARTS} starts in {line['best s']:.2f} s", flush=True)
        if small_gicp is not None:
            peers += beside_peer(case, model)
    with pd.option_context("display.width", 250, "display.max_columns", 20, "display.max_rows", 200):
        print(pd.DataFrame(speed).round(4).to_string(index=False))
        if peers:
            print(f"beside small_gicp, {PEER_STARTS} starts; agree: every swab point within {SAME} mm")
            print(pd.DataFrame(peers).round(4).to_string(index=False))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
