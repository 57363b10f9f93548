"""Terms of the fitness beyond the printed five: right after any milling, free when not asked for."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_cases import cone_volume, small_cone
from scipy import ndimage

from study.collision import Drill, find_approach
from study.errors import InputError
from study.planners import (
    CuttingForce,
    FitnessTerm,
    FitnessWeights,
    IncidenceAngle,
    PlannerSettings,
    leave_for_last,
    modified_volume,
    moments,
    plan_path,
)
from study.planners.fitness import compile_terms
from study.planners.moments import moment
from study.planners.planning import (
    _build,
    _choose_frame,
    _first_accessible,
)
from study.volumes import ball_element

NO_PRINTED = FitnessWeights(0.0, 0.0, 0.0, 0.0, 0.0)
DOF = (4, 5)


def uneven(volume, seed=0):
    """A density that differs from voxel to voxel, some of it air, some denser than 1."""
    density = np.random.default_rng(seed).uniform(0.0, 2.0, volume.shape)
    density[density < 0.4] = 0.0
    return density


def beside_the_pit(volume):
    """A structure along one wall of the pit of `cone_volume`."""
    structure = np.zeros(volume.shape, bool)
    structure[20:32, 2:6, :] = True
    return structure


def decided(volume, planner, dof, rows):
    """The planner's own arrays after `rows` rows, and the next candidates with their scores."""
    drill = Drill()
    modified = modified_volume(volume, drill.burr_radius)
    canonical = _choose_frame(modified, find_approach(volume), drill, planner, 12, dof)
    sim, _ = _build(canonical, drill, planner)
    start = _first_accessible(canonical, sim, planner)
    terms = compile_terms(planner.terms, volume, canonical.frame)
    return canonical.frame, sim, *moments.decided(sim, start, planner.weights.as_array(), terms, rows)


def bone_under_burr(sim, frame, voxel):
    """Canonical voxels of unmilled target that the burr overlaps at a voxel."""
    element = ball_element(Drill().burr_radius, frame.steps)
    offsets = np.argwhere(element) - np.array(element.shape) // 2
    where = voxel + offsets
    return where[sim.solid[tuple(where.T)] == 2], len(offsets)


def shaft_of(frame, burr):
    """Canonical unit vector of the shaft, by way of the axes a plan reports."""
    axis = frame.shaft_axes(burr[3:4], np.eye(3), burr[4:5])[0][list(frame.axes)]
    return axis * [1, frame.into_bone, 1]


def expected_force(sim, frame, density, voxel):
    bone, size = bone_under_burr(sim, frame, voxel)
    return max(0.0, 1 - density[tuple(bone.T)].sum() / (size / 2))


def expected_incidence(sim, frame, shaft, by_bone, voxel):
    bone, size = bone_under_burr(sim, frame, voxel)
    if len(bone) == 0:
        return 0.0 if by_bone else 1.0
    ahead = (bone.mean(axis=0) - voxel) * frame.steps
    length = np.linalg.norm(ahead)
    sine = np.linalg.norm(np.cross(ahead / length, shaft)) if length > 1e-9 else 1.0
    return sine * min(1.0, len(bone) / (size / 2)) if by_bone else sine


@pytest.mark.parametrize("dof", DOF)
@settings(max_examples=6)
@given(rows=st.integers(1, 400))
def test_force_is_that_of_counting_again(dof, rows):
    volume = cone_volume(spacing=(0.4, 0.5, 0.45), shape=(44, 40, 40))
    density = uneven(volume)
    planner = PlannerSettings(weights=NO_PRINTED, terms=(CuttingForce(2.0, density),))
    frame, sim, _, candidates, scores = decided(volume, planner, dof, rows)
    exact = frame.canonical(np.round(density, 3))
    wanted = [2 * expected_force(sim, frame, exact, voxel) for voxel in candidates]
    assert scores == pytest.approx(wanted, abs=1e-9)
    assert sim.live.ahead.size == 0


@pytest.mark.parametrize("dof", DOF)
@pytest.mark.parametrize("by_bone", [False, True])
@settings(max_examples=6)
@given(rows=st.integers(1, 400))
def test_incidence_is_that_of_looking_again(dof, by_bone, rows):
    volume = cone_volume(spacing=(0.4, 0.5, 0.45), shape=(44, 40, 40))
    planner = PlannerSettings(weights=NO_PRINTED, terms=(IncidenceAngle(3.0, by_bone),))
    frame, sim, burr, candidates, scores = decided(volume, planner, dof, rows)
    shaft = shaft_of(frame, burr)
    wanted = [3 * expected_incidence(sim, frame, shaft, by_bone, voxel) for voxel in candidates]
    assert scores == pytest.approx(wanted, abs=1e-9)
    assert sim.live.load.size == 0


def test_the_whole_fields_are_right_after_a_whole_plan():
    """Not only where candidates were: every voxel of the sums, milled and counted again."""
    volume = small_cone()
    planner = PlannerSettings(terms=(CuttingForce(1.0, uneven(volume)), IncidenceAngle(1.0)))
    frame, sim, *_ = decided(volume, planner, 4, 150)
    bone = sim.solid == 2
    assert bone.any()
    element = ball_element(Drill().burr_radius, frame.steps).astype(np.int64)
    weights = [sim.live.density, *np.concatenate([np.ones((1, *bone.shape)), np.indices(bone.shape)])]
    kept = [sim.live.load, *sim.live.ahead]
    for sums, weight in zip(kept, weights, strict=True):
        again = ndimage.convolve(np.where(bone, weight, 0).astype(np.int64), element, mode="constant")
        assert np.array_equal(sums, again)


@pytest.mark.parametrize("dof", DOF)
def test_terms_without_weight_change_nothing_and_keep_nothing(dof):
    volume = cone_volume()
    plain = plan_path(volume, dof=dof)
    idle = (CuttingForce(0.0, uneven(volume)), IncidenceAngle(0.0))
    same = plan_path(volume, dof=dof, settings=PlannerSettings(terms=idle))
    for name in ("points", "axes", "removed"):
        assert getattr(plain, name).tobytes() == getattr(same, name).tobytes()
    _, sim, *_ = decided(volume, PlannerSettings(terms=idle), dof, 1)
    assert [getattr(sim.live, name).size for name in sim.live._fields] == [0, 0, 0, 0]


def test_density_without_differences_is_density_1():
    volume = cone_volume()
    plans = [
        plan_path(volume, settings=PlannerSettings(terms=(CuttingForce(20.0, density),)))
        for density in (None, np.ones(volume.shape), np.ones(volume.shape, np.float32))
    ]
    assert plans[0].points.tobytes() == plans[1].points.tobytes() == plans[2].points.tobytes()
    assert plans[0].points.tobytes() != plan_path(volume).points.tobytes()


@pytest.mark.parametrize("dof", DOF)
@pytest.mark.parametrize(
    "make",
    [
        lambda v: CuttingForce(30.0, uneven(v)),
        lambda v: IncidenceAngle(10.0),
        lambda v: IncidenceAngle(10.0, by_bone=True),
        lambda v: leave_for_last(beside_the_pit(v), v.spacing, 40.0),
    ],
    ids=["force", "incidence", "incidence by bone", "leave for last"],
)
def test_plans_with_a_term_are_safe_and_complete(make, dof):
    volume = cone_volume()
    plan = plan_path(volume, dof=dof, settings=PlannerSettings(terms=(make(volume),)))
    plan.verify()
    assert plan.left.sum() <= 0.001 * plan.accessible.sum()
    assert plan.points.tobytes() != plan_path(volume, dof=dof).points.tobytes()


def test_a_moment_is_one_of_the_plan_with_its_terms():
    volume = cone_volume()
    terms = (CuttingForce(10.0), IncidenceAngle(5.0))
    plan = plan_path(volume, settings=PlannerSettings(terms=terms))
    assert moment(plan, len(plan.points) // 2).row >= len(plan.points) // 2


def test_leave_for_last_grows_from_touching_to_its_reach():
    structure = np.zeros((40, 9, 9), bool)
    structure[0, 4, 4] = True
    term = leave_for_last(structure, np.array([0.5, 0.5, 0.5]), 40.0, reach_mm=4.0, burr_radius=2.5)
    line = term.field[:, 4, 4]
    away = 0.5 * np.arange(40) - 2.5
    assert isinstance(term, FitnessTerm) and term.weight == 40.0
    assert line == pytest.approx(np.clip(away / 4, 0, 1))
    assert line[5] == 0 and line[13] == 1


def test_bone_around_a_structure_is_left_for_last():
    volume = cone_volume()
    structure = beside_the_pit(volume)
    distance = ndimage.distance_transform_edt(~structure, sampling=volume.spacing)

    def when(plan):
        """How much of the bone is gone before that near the structure, on average."""
        done = (np.cumsum(plan.removed) - plan.removed / 2) / plan.removed.sum()
        gap = distance[tuple(np.rint(volume.indices(plan.points)).astype(int).T)] - Drill().burr_radius
        return np.average(done[gap < 3], weights=plan.removed[gap < 3])

    plain = plan_path(volume)
    careful = plan_path(
        volume, settings=PlannerSettings(terms=(leave_for_last(structure, volume.spacing, 40.0),))
    )
    assert when(careful) > when(plain) + 0.1


def test_the_terms_that_do_not_fit_are_refused():
    volume = small_cone()
    wrong = np.ones((3, 4, 5))

    def plan(*terms):
        plan_path(volume, settings=PlannerSettings(terms=terms))

    with pytest.raises(InputError, match="density: expected the volume's shape"):
        plan(CuttingForce(1.0, wrong))
    with pytest.raises(InputError, match="at most one CuttingForce"):
        plan(CuttingForce(1.0), CuttingForce(2.0))
    with pytest.raises(InputError, match="expected FitnessTerm"):
        plan("cutting force")
    with pytest.raises(InputError, match="at most 4"):
        plan(*[FitnessTerm("one", 1.0, np.ones(volume.shape))] * 5)
    for make, message in [
        (lambda: CuttingForce(float("nan")), "finite weight"),
        (lambda: IncidenceAngle(float("inf")), "finite weight"),
        (lambda: CuttingForce(1.0, -wrong), "from 0 to 65"),
        (lambda: CuttingForce(1.0, wrong * np.nan), "finite"),
        (lambda: CuttingForce(1.0, wrong * 66), "from 0 to 65"),
        (lambda: CuttingForce(1.0, wrong[0]), r"\(nx, ny, nz\)"),
        (lambda: leave_for_last(np.zeros((3, 3, 3), bool), np.ones(3), 1.0), "a voxel set"),
        (lambda: leave_for_last(np.ones((3, 3), bool), np.ones(3), 1.0), r"\(nx, ny, nz\)"),
        (lambda: leave_for_last(wrong > 0, np.ones(3), 1.0, reach_mm=0.0), "reach_mm"),
        (lambda: leave_for_last(wrong > 0, np.ones(3), 1.0, burr_radius=-1.0), "burr_radius"),
    ]:
        with pytest.raises(InputError, match=message):
            make()


def test_the_printed_weights_stay_five():
    assert [field.name for field in fields(FitnessWeights)] == [
        "direction", "coverage", "boundary", "top_half", "upward",
    ]  # fmt: skip
