"""How long virtual experiments of the guided robot take.

``python benchmarks/guidance.py --experiments 1000`` drills as many aluminium blocks of 24 holes with each
system, and prints the time of one block and of all, beside what was aimed at: 10 s and 5 minutes.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from study.guidance import SYSTEMS, lateral_experiment, repeat_lateral, system
from study.guidance.fusion import FusionSettings, PoseFusion
from study.robots.arms import arm


def one_block(name: str) -> float:
    """Median time of one experiment in this process, s; the first, which loads kernels, does not count."""
    robot = system(name)
    lateral_experiment(robot, 0)
    times = []
    for seed in range(1, 6):
        begun = time.perf_counter()
        lateral_experiment(robot, seed)
        times.append(time.perf_counter() - begun)
    return float(np.median(times))


def fusion_step() -> float:
    """Time of one fused step in a record of 20000, s."""
    steps = 20_000
    fusion = PoseFusion(FusionSettings(), np.eye(4))
    velocity = np.zeros((steps, 6))
    poses = np.broadcast_to(np.eye(4), (steps, 4, 4))
    fresh = np.arange(steps) % 2 == 0
    fusion.run(velocity[:10], poses[:10], fresh[:10])
    begun = time.perf_counter()
    fusion.run(velocity, poses, fresh)
    return (time.perf_counter() - begun) / steps


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--experiments", type=int, default=1000)
    asked = parser.parse_args()
    for name in SYSTEMS:
        print(f"{name}: one block of 24 holes {one_block(name):.2f} s (aim 10 s)")
        for drawn in (False, True):
            begun = time.perf_counter()
            done = repeat_lateral(system(name), asked.experiments, drawn=drawn)
            took = time.perf_counter() - begun
            causes = "drawn" if drawn else "stated"
            print(
                f"  {asked.experiments} blocks, causes {causes}: {took:.0f} s (aim 300 s for 1000), "
                f"{len(done.aborted)} given up"
            )
    print(f"fusion: {1e6 * fusion_step():.1f} us a step of a record")
    for name in ("KR3", "RV-3S"):
        robot = arm(name)
        q = robot.ready
        pose = robot.forward(q)
        for what, call in (
            ("forward", lambda robot=robot, q=q: robot.forward(q)),
            ("inverse", lambda robot=robot, pose=pose: robot.inverse(pose)),
        ):
            begun = time.perf_counter()
            for _ in range(200):
                call()
            print(f"{name} {what}: {5e3 * (time.perf_counter() - begun):.1f} us")


if __name__ == "__main__":
    main()
