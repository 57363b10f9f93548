"""Force, angle and order of a plan's cuts, against paths whose cuts are known."""

import numpy as np
import pytest
from planning_cases import small_cone

from study.cases import Case
from study.errors import InputError
from study.experiments.cutting import (
    PRINTED_TERMS,
    case_density,
    changes,
    compare_terms,
    cutting,
    cutting_force,
    incidence_sine,
    term_claims,
    term_variants,
)
from study.planners import Plan, modified_volume, plan_path
from study.tables import claims_table
from study.volumes import PLANNING_NAMES, LabelVolume

UP = np.array([-1.0, 0.0, 0.0])  # from the burr towards the drill body


def through_a_block(points, axes=UP):
    """A plan that goes through points (mm) of a block of target with air around; removed is not filled in."""
    labels = np.zeros((60, 60, 60), np.uint8)
    labels[5:55, 5:55, 5:55] = 2
    volume = LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), PLANNING_NAMES)
    points = np.asarray(points, float)
    return Plan(
        points,
        np.tile(axes, (len(points), 1)),
        np.zeros(len(points)),
        modified=modified_volume(volume, 2.5),
    )


@pytest.mark.parametrize("axis, sine", [(0, 0.0), (1, 1.0), (2, 1.0)])
def test_the_pole_cuts_when_plunging_and_the_equator_sideways(axis, sine):
    points = np.full((20, 3), 12.0)
    points[:, axis] = 8.0 + 0.4 * np.arange(20)
    assert incidence_sine(through_a_block(points))[1:] == pytest.approx(sine, abs=1e-6)


def test_a_shaft_at_45_degrees_cuts_at_45():
    points = np.full((20, 3), 12.0)
    points[:, 0] = 8.0 + 0.4 * np.arange(20)
    slanted = through_a_block(points, np.array([-np.sqrt(0.5), np.sqrt(0.5), 0.0]))
    assert incidence_sine(slanted)[1:] == pytest.approx(np.sqrt(0.5))


def test_force_in_full_bone_is_the_section_of_what_the_burr_overlaps():
    """A burr pushed straight through solid bone cuts its section, pi r^2, and the voxels it touches."""
    points = np.full((30, 3), 12.0)
    points[:, 0] = 6.0 + 0.4 * np.arange(30)
    force = cutting_force(through_a_block(points), np.ones((60, 60, 60)))
    assert np.ptp(force[4:]) < 1e-9
    section = np.pi * 2.5**2
    touched = np.pi * (2.5 + 0.4 * np.sqrt(0.5)) ** 2
    assert section < force[-1] < touched
    assert cutting_force(through_a_block(points), np.full((60, 60, 60), 0.5)) == pytest.approx(force / 2)


def test_force_is_the_bone_of_the_last_mm():
    plan = plan_path(small_cone())
    way = np.concatenate([[0.0], np.cumsum(plan.step_lengths)])
    force = cutting_force(plan, window_mm=1.0)
    for row in np.random.default_rng(0).integers(1, len(way), 50):
        bone = 0.0
        for n in range(1, row + 1):
            length = way[n] - way[n - 1]
            if length > 0:
                bone += plan.removed[n] * np.clip((way[n] - (way[row] - 1.0)) / length, 0, 1)
        assert force[row] == pytest.approx(bone, abs=1e-9)
    with pytest.raises(InputError, match="window_mm"):
        cutting_force(plan, window_mm=0.0)


def test_bone_near_a_structure_is_all_that_goes_there():
    volume = small_cone()
    structure = np.zeros(volume.shape, bool)
    structure[12:16, 2, :] = True
    plan = plan_path(volume)
    record = cutting(plan, structure, near_mm=4.0)
    gone = volume.mask("target") & ~plan.remaining.mask("target")
    where = np.argwhere(gone)
    apart = np.sqrt(((where[:, None] - np.argwhere(structure)[None]) ** 2).sum(-1)).min(1) * 0.4
    assert record.near.sum() == pytest.approx((apart <= 4.0 + 1e-9).sum() * 0.064)
    assert 0 < record.near.sum() < plan.removed.sum()
    with pytest.raises(InputError, match="no bone within"):
        cutting(plan, structure, near_mm=0.1)
    with pytest.raises(InputError, match="structure"):
        cutting(plan, structure[1:])


def test_air_cells_of_the_target_cost_no_force():
    planning = small_cone()
    anatomy = planning.labels.copy()
    anatomy[12, 15:18, 15:18] = 3
    names = {"air": 0, "bone": 1, "drilled": 2, "air_cells": 3}
    density = case_density(Case("cone", planning, LabelVolume(anatomy, planning.affine, names)))
    assert np.array_equal(density == 0, planning.mask("air") | (anatomy == 3))
    assert set(np.unique(density)) == {0.0, 1.0}
    assert np.array_equal(case_density(Case("cone", planning)) == 0, planning.mask("air"))


def test_terms_are_compared_plan_by_plan():
    case = Case("cone", small_cone())
    structure = np.zeros(case.planning.shape, bool)
    structure[14:20, 3:5, 10:20] = True
    variants = term_variants(structure, case.planning.spacing, weights=(10.0, 40.0))
    kept = {name: variants[name] for name in (PRINTED_TERMS, "incidence by bone × 10", "leave for last × 40")}
    runs, records = compare_terms(case, structure, kept, dofs=(4,), seeds=(0, 1), near_mm=6.0)
    assert list(runs.index.names) == ["dof", "terms", "seed"] and len(runs) == 6
    assert set(records) == {(4, name) for name in kept}
    table = runs.groupby(level=["dof", "terms"], sort=False).mean()
    against = changes(table)
    first = against.xs(PRINTED_TERMS, level="terms")
    assert np.abs(first.to_numpy(float)).max() < 1e-9
    longer = table.loc[(4, "leave for last × 40"), "path_length_mm"]
    before = table.loc[(4, PRINTED_TERMS), "path_length_mm"]
    assert against.loc[(4, "leave for last × 40"), "path_pct"] == pytest.approx(100 * (longer / before - 1))
    claims = claims_table(term_claims(table))
    assert len(claims) == 2
    # A table in which nothing changes supports no claim.
    same = table.copy()
    same.loc[:] = table.xs(PRINTED_TERMS, level="terms").to_numpy().repeat(3, axis=0)
    assert not any(claim.holds for claim in term_claims(same))
