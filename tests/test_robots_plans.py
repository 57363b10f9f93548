"""The robot on real plans: the planner's own, not the fakes of the other tests."""

import numpy as np
import pytest
from real_data import real

from study.errors import InputError, PlanViolation
from study.planners import Plan, plan_path
from study.robots import FeedSettings, RoundingSettings, predict_milling
from study.robots.feed import weighted_removal
from study.volumes import LabelVolume, read_volume


@pytest.fixture(scope="module")
def pocket():
    """A pocket in a block of bone, with a wall of its own inside, so that paths bend."""
    labels = np.zeros((48, 44, 40), np.uint8)
    labels[:, :, :30] = 1
    labels[10:38, 10:34, 8:30] = 2
    labels[18:22, 10:24, 8:22] = 1
    return LabelVolume(labels, np.diag([0.5, 0.5, 0.5, 1.0]), {"air": 0, "protected": 1, "target": 2})


@pytest.fixture(scope="module", params=[("3d", 4), ("zigzag", 4), ("3d", 5), ("zigzag", 5)], ids=str)
def plan(request, pocket):
    strategy, dof = request.param
    return plan_path(pocket, strategy, dof)


def test_the_rounded_path_is_shorter_verified_and_leaves_no_more_bone(plan):
    milling = predict_milling(plan)
    assert milling.path_length_mm < milling.path.planned_length_mm
    assert milling.path.planned_length_mm == pytest.approx(plan.length_mm)
    replayed = milling.verify()
    assert replayed["remaining_target_mm3"] == pytest.approx(plan.remaining.volume_mm3("target"))


def test_rounding_where_bone_is_cut_leaves_some_of_it(plan):
    everywhere = predict_milling(plan, rounding=RoundingSettings(keep_cutting_corners=False))
    assert everywhere.path_length_mm < predict_milling(plan).path_length_mm
    points, axes = everywhere.robot.forward(everywhere.trajectory.joints)
    driven = Plan(points, axes, np.zeros(len(points)), modified=plan.modified)
    removed = weighted_removal(driven, np.ones(plan.modified.volume.shape)).sum()
    assert removed < plan.removed.sum()


def test_a_path_through_protected_bone_is_found_out(plan):
    points = plan.points.copy()
    deep = int(np.argmin(points[:, 2]))
    points[deep:, 2] -= 2.0
    moved = Plan(points, plan.axes, plan.removed, dof=plan.dof, approach=plan.approach,
                 rotation_axis=plan.rotation_axis, modified=plan.modified)  # fmt: skip
    with pytest.raises(PlanViolation):
        predict_milling(moved, rounding=RoundingSettings(corner_tolerance=0)).verify()


def test_replayed_bone_is_what_the_planner_counted(plan):
    ones = np.ones(plan.modified.volume.shape)
    np.testing.assert_array_equal(weighted_removal(plan, ones), plan.removed)
    assert predict_milling(plan, density=ones).time_s == predict_milling(plan).time_s


def test_a_plan_from_a_file_mills_like_the_original(plan, pocket, tmp_path):
    plan.to_csv(tmp_path / "plan.csv")
    known = {"approach": plan.approach, "rotation_axis": plan.rotation_axis, "dof": plan.dof}
    again = Plan.read_csv(tmp_path / "plan.csv", volume=pocket, **known)
    np.testing.assert_allclose(predict_milling(again).summary(), predict_milling(plan).summary())
    with pytest.raises(InputError, match="rotation axis"):
        predict_milling(Plan.read_csv(tmp_path / "plan.csv", volume=pocket, dof=plan.dof))


@pytest.mark.parametrize("dof", [4, 5])
def test_a_real_bone_is_milled_within_the_limits(dof):
    volume = read_volume(real("temporal_bone/LT143/planning_0p38.nrrd"))
    plan = plan_path(volume, "3d", dof)
    milling = predict_milling(plan)
    assert 0 < milling.path.shortening < 0.15
    assert 0.5 < milling.mean_speed_mm_per_s < 5.0
    slow = predict_milling(plan, feed=FeedSettings(removal_rate=1e-3))
    moving = slow.motion.removed > 0
    assert (slow.speeds[moving & (slow.motion.lengths > 0)] == 0.5).all()
    milling.verify()
