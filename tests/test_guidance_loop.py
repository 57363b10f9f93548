"""The compiled loop against plain Python, tick by tick, and what a drilled hole says of itself."""

from dataclasses import replace

import numpy as np
import pytest
from guidance_reference import Reference

from study.guidance import Faults, HoleRun, LoopSettings, Phantom, SafetySettings, set_up, system
from study.guidance.control import ControlSettings
from study.guidance.filters import PatientFilterSettings
from study.guidance.frames import rigid

DOWN = np.diag([1.0, -1.0, -1.0])
SPHERES = [[-40.0, -25.0, 5.0], [40.0, -25.0, 5.0], [0.0, 30.0, 5.0], [20.0, 30.0, -5.0]]


def short_hole(tilt=0.0, length=3.0):
    """A hole of a few mm, so that all phases pass in a few seconds."""
    entry = np.array([5.0, -3.0, 0.0])
    target = entry + length * np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    return Phantom("short", SPHERES, entry, target, rigid(DOWN, [450.0, 0.0, 180.0]), 0.5)


def compared(run, stops):
    """Run both loops side by side to these times, stopped robots told to go on, and compare what they log."""
    reference = Reference(run._inputs, run._state)
    run.run(stops[0])
    reference.run(0, run._at)
    for until in stops[1:]:
        at = run._at
        if run.status.stopped:
            run.resume()
            reference.resume()
        run.run(until)
        reference.run(at, run._at)
    rows = np.array(reference.log)
    log = run._log[: len(rows)]
    assert len(rows) == len(run.result.time_s)
    assert np.array_equal(log[:, 8:10], rows[:, 8:10])  # status and phase
    assert np.abs(log[:, :8] - rows[:, :8]).max() < 1e-9
    assert np.allclose(log[:, 10], rows[:, 10], rtol=1e-6, atol=1e-8)  # NIS
    return run


def random_case(seed):
    """A hole with drawn causes, gains, noises and faults; times at which a stopped robot is told to go on."""
    rng = np.random.default_rng(seed)
    causes = {
        "insertion_mm_s": rng.uniform(1, 4),
        "drive_lag_s": rng.uniform(0.01, 0.1),
        "tracker_delay_s": rng.choice([0.02, 0.04, 0.06, 0.08]),
        "tracker_cycle_s": rng.choice([0.02, 0.04, 0.1]),
        "tracker_quantum_mm": rng.choice([0.0, 0.01]),
    }
    robot = system(str(rng.choice(["hannover", "vanderbilt"])), **causes)
    settings = LoopSettings(
        ControlSettings(*rng.uniform([0.5, 0, 0.5, 0], [5, 2, 5, 2]), *rng.uniform([2, 0.02], [20, 0.2])),
        SafetySettings(missing_samples=int(rng.integers(0, 3)), outlying_samples=int(rng.integers(1, 4))),
        settle_s=0.2,
        stay_s=0.2,
        approach_mm=1.0,
        wait_mm=rng.uniform(0.2, 2.0),
        patient=replace(
            PatientFilterSettings(), position_static=rng.uniform(0.05, 0.9), threshold=rng.uniform(1, 5)
        ),
        fusion=replace(
            LoopSettings().fusion,
            gate=rng.choice([0.0, 0.95, 1 - 1e-6]),
            process_position_mm=rng.uniform(0.002, 0.1),
        ),
    )
    at = rng.uniform(0, 2.5, 8)
    choices = [
        {},
        {"occluded": [(str(rng.choice(["tool", "base", "patient"])), at[0], at[0] + 0.2)]},
        {"frozen": [(at[1], at[1] + 0.3)], "spikes": [(at[2], rng.normal(0, 3, 3))]},
        {"silent": [(at[3], at[3] + 0.3)]},
        {"patient_moves": [(at[4], at[4] + 0.5, rng.normal(0, 0.5, 3))]},
        {"no_handshake": [(at[5], at[5] + 0.1)], "patient_moves": [(at[6], at[6], [2.0, 0.0, 0.0])]},
    ]
    ready = set_up(robot, short_hole(rng.uniform(-0.3, 0.3), 2.0), rng)
    run = HoleRun(ready, 0, rng, settings, Faults(**choices[seed % len(choices)]))
    return run, (1.5, 3.0, 4.5)


@pytest.mark.parametrize("seed", range(12))
def test_loop_is_the_plain_one(seed):
    run, stops = random_case(seed)
    compared(run, stops)
