"""Faults while a hole is drilled: when the robot stops, how far it still moves, and that it waits to be told.

Bounds follow from the causes. A fault is noticed with the picture that shows it: at most a tracker's cycle
to be in one, its delay, and a step of the fusion; with the second or third picture where one does not tell.
What the robot was told before it does for two cycles of its control box, and slides on for the drives' lag.
Meanwhile it goes as fast as it inserts, and towards the line by the controller's gain.
"""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study.errors import GuidanceError
from study.guidance import Faults, HoleRun, LoopSettings, Status, aluminium_block, set_up, system

SETTINGS = LoopSettings()
HOLE, SEED = 3, 1
#: While the drill is in the bone on its way in, for all of these systems.
BONE_S = (13.0, 45.0)
#: Where holes are compared, mm.
DEPTHS = (0.0, 20.0, 35.0)
#: Pictures that a fault needs to be noticed.
PICTURES = {
    Status.LINE_OF_SIGHT: 2,  # two that do not arrive; one that shows a marker hidden
    Status.HANDSHAKE: 0,
    Status.FROZEN: 2,
    Status.OUTLIERS: 3,
    Status.PATIENT_MOVED: 1,
}


@cache
def ready(name):
    """Without the arm's wandering, so that one that stands is told from one that moves."""
    return set_up(system(name, robot_repeatability_mm=0.0), aluminium_block(), 0)


def drilled(name, faults=None, until=None):
    run = HoleRun(ready(name), HOLE, SEED, faults=faults)
    run.run(until)
    return run


@cache
def faultless(name):
    run = drilled(name)
    assert run.status is Status.DONE
    return run.result


@cache
def noise(name):
    """(3,) mm by which holes at one place differ as the noise does, root mean squared distance."""
    holes = []
    for seed in range(12):
        run = HoleRun(ready(name), HOLE, seed)
        run.run()
        hole = run.result
        holes.append([hole.error_at(depth) for depth in DEPTHS])
    return np.sqrt(np.var(holes, axis=0).sum(axis=-1))


def across(hole, tip=None):
    off = (hole.tip if tip is None else tip) - hole.entry
    return np.linalg.norm(off - (off @ hole.direction)[:, None] * hole.direction, axis=1)


def speed(name):
    """mm/s: the operator's, and what the controller adds while the tip is as far off as he lets it be."""
    return system(name).insertion_mm_s + SETTINGS.control.position_gain * SETTINGS.wait_mm


def noticed_s(name, status):
    """Longest time from a fault to the stop, s."""
    robot = system(name)
    if status is Status.HANDSHAKE:
        return robot.robot_cycle_s + SETTINGS.fusion.sample_s
    return PICTURES[status] * robot.tracker_cycle_s + robot.tracker_delay_s + SETTINGS.fusion.sample_s


def stops_in_time(name, faults, at, status, shift=(0.0, 0.0, 0.0)):
    """The robot stops for this reason; how it moves until it stands; then it stands."""
    robot = system(name)
    run = drilled(name, faults, at + 4.0)
    hole = run.result
    assert run.status is status
    stopped = hole.time_s[np.flatnonzero(hole.status == status)[0]]
    assert 0 <= stopped - at <= noticed_s(name, status)
    assert (hole.status[hole.time_s < stopped] == Status.RUNNING).all()
    # In the room, which a patient who moves leaves behind.
    # The log moves him with the next picture.
    seen = robot.tracker_cycle_s * np.ceil(at / robot.tracker_cycle_s - 1e-9)
    moved = np.outer(hole.time_s >= seen - 1e-9, run.ready.phantom.T_rob_img[:3, :3].T @ shift)
    tip = hole.tip + moved
    since = hole.time_s >= at - robot.tracker_cycle_s
    told = 2 * robot.robot_cycle_s
    travel = np.linalg.norm(tip[since] - tip[since][0], axis=1).max()
    assert travel < speed(name) * (stopped - at + robot.tracker_cycle_s + told + robot.drive_lag_s)
    usual = faultless(name)
    assert across(hole, tip)[since].max() < across(usual)[usual.phase > 0].max() + 0.1
    # It stands: nothing is told, and what was is forgotten within some lags.
    assert not run._state.told.any()
    assert not run._state.pending.any()
    standing = hole.time_s > stopped + told + 10 * robot.drive_lag_s
    assert np.ptp(tip[standing], axis=0).max() < 1e-5
    assert np.array_equal(hole.depth[standing], np.full(standing.sum(), hole.depth[-1]))
    assert np.isfinite(run._log[: len(hole.time_s)]).all()
    return run


def goes_on_well(run, name, commands=1):
    """Told to go on it ends the hole, as good as without the fault."""
    for _ in range(commands):
        run.resume()
        assert run.status is Status.RUNNING
        if run.run() is Status.DONE:
            break
    assert run.status is Status.DONE
    hole, usual = run.result, faultless(name)
    for depth, size in zip(DEPTHS, noise(name), strict=True):
        # Other noise comes by, and two holes differ by more than one.
        assert np.linalg.norm(hole.error_at(depth) - usual.error_at(depth)) < 3.0 * np.sqrt(2.0) * size
    with pytest.raises(GuidanceError, match="resume"):
        run.resume()


names = st.sampled_from(["hannover", "vanderbilt"])
times = st.floats(*BONE_S)
directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1)


def of_length(direction, length):
    return length * np.array(direction) / np.linalg.norm(direction)


@settings(deadline=None, max_examples=12)
@given(names, times, st.sampled_from(["tool", "base", "patient"]), st.floats(0.05, 2.0))
def test_lost_line_of_sight(name, at, marker, seconds):
    run = stops_in_time(name, Faults(occluded=[(marker, at, at + seconds)]), at, Status.LINE_OF_SIGHT)
    goes_on_well(run, name)


@settings(deadline=None, max_examples=8)
@given(names, times, st.floats(0.15, 2.0))
def test_a_tracker_that_repeats_itself(name, at, seconds):
    goes_on_well(stops_in_time(name, Faults(frozen=[(at, at + seconds)]), at, Status.FROZEN), name)


@settings(deadline=None, max_examples=8)
@given(names, times, st.floats(0.15, 2.0))
def test_a_tracker_that_falls_silent(name, at, seconds):
    goes_on_well(stops_in_time(name, Faults(silent=[(at, at + seconds)]), at, Status.LINE_OF_SIGHT), name)


@settings(deadline=None, max_examples=8)
@given(names, times)
def test_a_missed_handshake(name, at):
    cycle = system(name).robot_cycle_s
    goes_on_well(stops_in_time(name, Faults(no_handshake=[(at, at + cycle)]), at, Status.HANDSHAKE), name)


@settings(deadline=None, max_examples=12)
@given(names, times, directions, st.floats(5.0, 1000.0))
def test_three_outliers_in_a_row(name, at, direction, size):
    cycle = system(name).tracker_cycle_s
    at = cycle * round(at / cycle)
    spikes = [(at + k * cycle, of_length(direction, size)) for k in range(3)]
    # It looks anew; one noisy picture in a hundred tells it that it is off its line.
    goes_on_well(stops_in_time(name, Faults(spikes=spikes), at, Status.OUTLIERS), name, commands=3)


@settings(deadline=None, max_examples=12)
@given(names, times, directions, st.floats(0.01, 1000.0))
def test_one_outlier_is_not_believed(name, at, direction, size):
    run = drilled(name, Faults(spikes=[(at, of_length(direction, size))]))
    assert run.status is Status.DONE
    hole, usual = run.result, faultless(name)
    assert across(hole)[hole.phase > 0].max() < across(usual)[usual.phase > 0].max() + 0.1
    assert np.linalg.norm(hole.error_at(35.0) - usual.error_at(35.0)) < 0.02


@settings(deadline=None, max_examples=12)
@given(names, st.floats(0.0, 2.0), directions, st.floats(0.1, 1000.0), st.integers(1, 4))
def test_outliers_while_the_line_is_found(name, at, direction, size, count):
    """At most the very first picture is taken for the truth; then the robot stops for the others."""
    cycle = system(name).tracker_cycle_s
    spikes = [(at + k * cycle, of_length(direction, size)) for k in range(count)]
    run = drilled(name, Faults(spikes=spikes), 5.0)
    hole = run.result
    start = across(faultless(name)).max()
    if at > 2 * cycle:
        assert across(hole).max() < start + 1.0
        assert hole.along.max() < hole.depth.max() + 1.0
    if run.status.stopped:
        assert run.status is Status.OUTLIERS
        goes_on_well(run, name)


@settings(deadline=None, max_examples=12)
@given(names, times, directions, st.floats(3.0, 50.0))
def test_a_patient_who_jumps(name, at, direction, size):
    shift = of_length(direction, size)
    faults = Faults(patient_moves=[(at, at, shift)])
    run = stops_in_time(name, faults, at, Status.PATIENT_MOVED, shift)
    # The drill sticks in a bone that went elsewhere: told to go on it looks anew, and stops again.
    off = (run.ready.phantom.T_rob_img[:3, :3].T @ shift)[:2]
    run.resume()
    run.run()
    if np.linalg.norm(off) > 2.0:
        assert run.status is Status.OFF_LINE


@settings(deadline=None, max_examples=8)
@given(names, st.floats(13.0, 25.0), directions, st.floats(0.0, 2.0))
def test_a_patient_who_moves_slowly_is_followed(name, at, direction, size):
    shift = of_length(direction, size)
    run = drilled(name, Faults(patient_moves=[(at, at + 10.0, shift)]))
    assert run.status is Status.DONE
    hole, usual = run.result, faultless(name)
    # 0.2 mm/s: the heavy filter is 9 samples late, the tracker one, the controller half a second.
    late = 0.2 * (10 * 0.04 + 0.04 + 0.5)
    assert across(hole)[hole.phase == 1].max() < across(usual)[usual.phase == 1].max() + late + 0.1
    assert np.linalg.norm(hole.error_at(35.0) - usual.error_at(35.0)) < 0.1


def test_a_patient_who_moves_before_the_drill_is_in_the_bone_is_followed_too():
    run = drilled("hannover", Faults(patient_moves=[(4.0, 4.0, (5.0, -3.0, 2.0))]))
    assert run.status is Status.DONE
    assert np.linalg.norm(run.result.error_at(0.0) - faultless("hannover").error_at(0.0)) < 0.15


def test_a_stopped_robot_waits_for_its_command():
    run = drilled("hannover", Faults(occluded=[("tool", 20.0, 20.5)]), 30.0)
    assert run.status is Status.LINE_OF_SIGHT  # though the marker has long been seen again
    before = run.result.depth[-1]
    run.run(33.0)
    assert run.status is Status.LINE_OF_SIGHT
    assert run.result.depth[-1] == before
    run.resume()
    run.run(33.5)
    assert run.result.depth[-1] > before


def test_without_a_time_a_stop_ends_the_run_and_leaves_time_for_the_rest():
    run = drilled("vanderbilt", Faults(no_handshake=[(20.0, 20.1)]))
    assert run.status is Status.HANDSHAKE
    assert run.time_s < 25.0
    goes_on_well(run, "vanderbilt")


def test_stopped_again_while_the_fault_lasts():
    run = drilled("hannover", Faults(occluded=[("base", 20.0, 24.0)]), 22.0)
    run.resume()
    run.run(23.0)
    assert run.status is Status.LINE_OF_SIGHT
    run.run(25.0)
    goes_on_well(run, "hannover")


def test_the_operator_waits_while_the_tip_is_off_the_line():
    patient = LoopSettings(wait_mm=0.15)
    run = HoleRun(ready("hannover"), HOLE, SEED, patient)
    run.run()
    hole = run.result
    inserting = (hole.phase[1:] == 1) & (hole.phase[:-1] == 1)
    forward = np.diff(hole.depth) > 0
    assert (hole.seen_across[1:] >= 0.15)[inserting].any()
    assert np.array_equal(forward[inserting], (hole.seen_across[1:] < 0.15)[inserting])


def test_off_the_line_in_the_bone():
    """A patient who drifts faster than he can be followed."""
    run = drilled("hannover", Faults(patient_moves=[(20.0, 24.0, (30.0, 0.0, 0.0))]), 26.0)
    assert run.status in (Status.OFF_LINE, Status.PATIENT_MOVED)
    hole = run.result
    assert hole.seen_across[hole.status == 0].max() <= SETTINGS.safety.off_line_mm


def test_pieces_are_the_whole():
    faults = Faults(spikes=[(15.0, (5.0, 0, 0))], patient_moves=[(20.0, 25.0, (1.0, 0, 0))])
    whole, pieces = drilled("hannover", faults), HoleRun(ready("hannover"), HOLE, SEED, faults=faults)
    while pieces.status is Status.RUNNING:
        pieces.run(pieces.time_s + 0.777)
    for name in ("tip", "axis", "depth", "status", "seen_across", "bent", "phase", "time_s"):
        assert np.array_equal(getattr(whole.result, name), getattr(pieces.result, name))


def test_before_anything_happened():
    run = HoleRun(ready("hannover"), HOLE, SEED)
    assert run.status is Status.RUNNING
    assert run.result.end is Status.RUNNING
    with pytest.raises(GuidanceError, match="resume"):
        run.resume()
    for ask in (lambda: run.result.bottom, lambda: run.result.error_at(3.0)):
        with pytest.raises(GuidanceError, match="did not"):
            ask()
