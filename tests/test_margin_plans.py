"""A target, its margins and the plan that is left."""

import numpy as np
import pandas as pd
import pytest

from study.cases import Case
from study.errors import InputError
from study.experiments.margin_plans import (
    cost_rows,
    error_model,
    plan_risk,
    plan_row,
    planned,
    risk_claims,
    risk_rows,
)
from study.experiments.margin_survey import grow_margins
from study.margins import GrowthSettings, grow_margin, reduced_target
from study.registration import CombinedErrors, PointRegistration
from study.volumes import LabelVolume, resampled

FIDUCIALS = np.array(
    [[0, -20, 0], [12, -18, 0], [0, -22, 12], [12, -19, 13], [-8, -20, 5], [20, -21, 6]], float
)
SETTINGS = GrowthSettings(registrations=400, confidence=None, validation_registrations=400)
STRUCTURES = ("facial_nerve", "chorda_tympani")


@pytest.fixture(scope="module")
def case():
    """A block of bone with a target at its top, a nerve under the target and a thread beside it."""
    labels = np.zeros((30, 32, 30), np.uint8)
    labels[:, 12:, :] = 1
    labels[4:26, 12:24, 4:26] = 2
    planning = LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), {"air": 0, "protected": 1, "target": 2})
    tissue = np.where(labels == 0, 0, 1).astype(np.uint8)
    tissue[:, 24:27, 13:16] = 2
    tissue[26:28, 12:, 14:16] = 3
    names = {"air": 0, "bone": 1, "facial_nerve": 2, "chorda_tympani": 3}
    return Case("block", planning, planning.with_labels(tissue, names), np.array([0.0, 1, 0]), FIDUCIALS)


@pytest.fixture(scope="module")
def margins(case):
    found, skipped = grow_margins(case, case.anatomy, PointRegistration(FIDUCIALS), SETTINGS, 0, STRUCTURES)
    assert skipped == {}
    return found


@pytest.fixture(scope="module")
def entries(case, margins):
    return [planned("drawn", case, case.planning), planned("margins", case, case.planning, margins)]


def test_target_is_reduced_as_by_all_margins_at_once(case, margins, entries):
    want = reduced_target(case.planning, margins)
    np.testing.assert_array_equal(entries[1].planning.labels, want.labels)
    assert entries[1].spared.sum() > 0
    assert (entries[1].spared == np.logical_or.reduce(list(entries[1].taken.values()))).all()
    np.testing.assert_array_equal(entries[0].planning.labels, case.planning.labels)


def test_costs_add_up(entries):
    costs = cost_rows(entries[1])
    alone, together = costs.loc[list(STRUCTURES)], costs.loc["all together"]
    voxel = entries[1].drawn.voxel_volume
    assert together["target_mm3"] == pytest.approx(entries[1].spared.sum() * voxel)
    assert alone["target_mm3"].max() <= together["target_mm3"] <= alone["target_mm3"].sum() + 1e-9
    rows = [plan_row(entry) for entry in entries]
    lost = 1000 * (rows[0]["modified_target_cm3"] - rows[1]["modified_target_cm3"])
    assert together["modified_target_mm3"] == pytest.approx(lost)
    assert rows[1]["milled_cm3"] == pytest.approx(rows[1]["target_cm3"] - rows[1]["bone_left_mm3"] / 1000)
    assert rows[1]["milling_time_s"] > 0


def brute_risk(entry, margin, n, rng):
    """Every corner of every milled voxel, registration by registration."""
    volume = entry.planning
    removed = np.argwhere(entry.plan.volume.mask("target") & ~entry.plan.remaining.mask("target"))
    offsets = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    corners = volume.points(np.unique((removed[:, None] + offsets).reshape(-1, 3), axis=0) - 0.5)
    solid = margin.structure_mask
    hits = 0
    for T in margin.model.sample(n, np.random.default_rng(rng)):
        index = np.floor(margin.volume.indices(corners @ T[:3, :3].T + T[:3, 3]) + 0.5).astype(int)
        inside = ((index >= 0) & (index < solid.shape)).all(axis=1)
        hits += solid[tuple(index[inside].T)].any()
    return hits / n


def test_risk_of_a_plan_is_that_of_every_corner_it_mills(entries, margins):
    for entry in entries:
        for margin in margins:
            found = plan_risk(entry.plan, margin, 60, 5)
            assert found.risk == pytest.approx(brute_risk(entry, margin, 60, 5)), (
                entry.name,
                margin.structure,
            )


def test_a_plan_that_respects_a_margin_is_as_safe_as_the_margin(entries, margins):
    table = risk_rows(entries, {"registration": margins}, 2000, 3)
    assert (table["drawn"] > 0.5).any()
    for margin in margins:
        overall = margin.risk_on(2000, 3)
        assert table.loc[("registration", margin.structure), "margins"] <= overall.risk
    claims = risk_claims(table)
    assert [claim.holds for claim in claims] == [False, True]
    assert "facial nerve" in claims[0].evidence


def test_risk_is_the_same_on_finer_voxels_of_the_same_structure(case, entries, margins):
    coarse = margins[0]
    fine_mask = resampled(case.anatomy, 0.2, "nearest")
    fine = grow_margin(fine_mask, "facial_nerve", coarse.model, settings=SETTINGS, rng=0)
    # voxels of half the size put more corners on the same faces: hits can only be added
    found = plan_risk(entries[0].plan, fine, 400, 5).risk, plan_risk(entries[0].plan, coarse, 400, 5).risk
    assert found[1] <= found[0] <= 1
    odd = grow_margin(case.anatomy.padded(2.0), "facial_nerve", coarse.model, settings=SETTINGS, rng=0)
    with pytest.raises(InputError, match="fills the box"):
        plan_risk(entries[0].plan, odd, 10, 0)


def test_errors_that_are_zero_are_no_source():
    assert isinstance(error_model(FIDUCIALS), PointRegistration)
    assert isinstance(error_model(FIDUCIALS, force_n=3.0), PointRegistration)
    model = error_model(FIDUCIALS, 0.1, 0.1, 0.001, 0.2, 0.1, 0.02, 5.0)
    assert isinstance(model, CombinedErrors) and len(model.sources) == 3
    point = np.array([[5.0, 10.0, 5.0]])
    want = PointRegistration(FIDUCIALS, 0.1).tre_covariance(point)[0]
    away = point[0] - FIDUCIALS.mean(axis=0)
    turn = np.deg2rad(0.1) ** 2 * (away @ away * np.eye(3) - np.outer(away, away))
    want = want + (0.1**2 + 0.2**2 + (0.02 * 5) ** 2) * np.eye(3) + np.diag((0.001 * away) ** 2) + turn
    np.testing.assert_allclose(model.moments().at(point)[0], want, rtol=1e-9)


def test_structures_that_are_missing_are_named(case):
    asked = ("facial_nerve", "sigmoid_sinus")
    found, skipped = grow_margins(case, case.anatomy, PointRegistration(FIDUCIALS), SETTINGS, 0, asked)
    assert [margin.structure for margin in found] == ["facial_nerve"]
    assert skipped["sigmoid_sinus"].startswith("absent")
    with pytest.raises(InputError, match="sigmoid_sinus"):
        grow_margins(case, case.anatomy, PointRegistration(FIDUCIALS), SETTINGS, 0, asked[1:])


def test_claims_name_the_structures_that_are_over():
    index = pd.MultiIndex.from_product([["all"], ["a_b", "c"]], names=["errors", "structure"])
    risks = pd.DataFrame({"acceptable_risk": [0.01, 0.1], "plan": [0.02, 0.05]}, index)
    (claim,) = risk_claims(risks)
    assert not claim.holds and claim.evidence == "times the tolerance: a b 2"
    risks["plan"] = [0.005, 0.1]
    (claim,) = risk_claims(risks)
    assert claim.holds and claim.evidence == "at most 1 of it"
