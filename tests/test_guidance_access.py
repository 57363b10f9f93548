"""Linear access to the cochlea: who is touched, how probably, and which line does the least damage."""

import time
from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real
from scipy import stats

from study import published
from study.errors import (
    GeometryError,
    GuidanceError,
    InputError,
    LabelError,
    PlanningError,
    TargetUnreachableError,
)
from study.guidance.access import (
    AccessSettings,
    AnyRoll,
    DrawnErrors,
    FittedErrors,
    LineErrors,
    NormalErrors,
    collision_probability,
    drill_axes,
    oval_window,
    plan_access,
    printed_absolute,
    printed_lateral,
    required_std,
    risk_curve,
    rms_across,
    round_window_target,
    surroundings,
    to_drill_axes,
    to_image_axes,
    transforms,
    warm,
)
from study.margins import GrowthSettings, grow_margin
from study.registration.sources import ErrorSource
from study.specimens import read_temporal_bone_case, specimen, structure_mask
from study.specimens.orientation import lateral_direction
from study.volumes import LabelVolume

ENTRY, TARGET = np.array([-20.0, 3.0, 2.0]), np.array([5.0, -1.0, 0.5])
FEW = AccessSettings(samples=1500, simulated=4, refined=2)


def segment_distances(points, start, end):
    """Plain distances (m,) of points from one segment."""
    line = end - start
    share = np.clip((points - start) @ line / (line @ line), 0, 1)
    return np.linalg.norm(start + share[:, None] * line - points, axis=1)


@cache
def planned(name="TB14", std=0.15):
    return plan_access(specimen(name).anatomy, settings=FEW, errors=NormalErrors(std, std))


# Distances and counts


@pytest.mark.parametrize("size", [0.0, 0.2, 1.0, 8.0])
def test_clearances_are_those_of_all_voxels_one_by_one(size):
    rng = np.random.default_rng(3)
    structures = {
        "beside": rng.normal((-8, 4, 3), (6, 1, 1), (400, 3)),
        "in front of the tip": rng.normal((9, -2, 0), 2, (300, 3)),
        "a single voxel": np.array([[0.0, 0.0, 0.0]]),
        "behind the entry": rng.normal((-26, 3, 2), 2, (50, 3)),
    }
    errors = size * rng.standard_normal((200, 2, 3))
    found = collision_probability(structures, ENTRY, TARGET, errors, 0.75)
    for column, points in enumerate(structures.values()):
        expected = [
            segment_distances(points, ENTRY + entry, TARGET + target).min() - 0.75 for entry, target in errors
        ]
        np.testing.assert_allclose(found.clearances[:, column], expected, atol=1e-12)
        assert found.hits.iloc[column] == sum(value <= 0 for value in expected)
    np.testing.assert_allclose(
        found.planned, [segment_distances(p, ENTRY, TARGET).min() - 0.75 for p in structures.values()]
    )


def wall(distance):
    """Points of a wall, so dense and wide that it is flat for a drill along x, at y = distance."""
    x, z = np.meshgrid(np.arange(-30, 30, 0.1), np.arange(-0.3, 0.31, 0.1))
    return np.column_stack([x.ravel(), np.full(x.size, distance), z.ravel()])


@pytest.mark.parametrize("correlation", [0.0, 1.0])
def test_a_flat_wall_is_touched_as_often_as_normal_theory_says(correlation):
    entry, target = np.array([-15.0, 0, 0]), np.array([15.0, 0, 0])
    std, radius, distance = 0.3, 0.75, 1.2
    errors = NormalErrors((0, std, 0), (0, std, 0), correlation).sample(40_000, 1)
    found = collision_probability({"wall": wall(distance)}, entry, target, errors, radius)
    # The drill touches where either end comes near enough: one normal variable, or the larger of two.
    one_end = stats.norm.sf((distance - radius) / std)
    expected = one_end if correlation else 1 - (1 - one_end) ** 2
    low, high = found.risk("wall").interval
    assert low <= expected <= high
    table = found.table().loc["wall"]
    assert (table["low"], table["high"]) == (low, high)
    assert table["least_clearance_mm"] <= table["clearance_1st_percentile_mm"] <= table["mean_clearance_mm"]
    if correlation:
        assert found.normal[0] == pytest.approx(expected, rel=0.05)


def test_a_bias_shifts_the_normal_theory_and_the_count():
    entry, target = np.array([-15.0, 0, 0]), np.array([15.0, 0, 0])
    errors = NormalErrors((0, 0.2, 0), (0, 0.2, 0), 1.0, [[0, 0.3, 0], [0, 0.3, 0]]).sample(40_000, 2)
    found = collision_probability({"wall": wall(1.4)}, entry, target, errors, 0.75)
    expected = stats.norm.sf((1.4 - 0.75 - 0.3) / 0.2)
    assert found.normal[0] == pytest.approx(expected, rel=0.05)
    low, high = found.risk("wall").interval
    assert low <= expected <= high


def test_whole_voxels_are_touched_sooner_by_half_a_diagonal():
    errors = np.random.default_rng(0).normal(0, 0.4, (2000, 2, 3))
    points = {"block": np.array([[0.0, 1.5, 1.0], [2.0, 1.8, 1.0]])}
    centres = collision_probability(points, ENTRY, TARGET, errors, 0.75)
    whole = collision_probability(points, ENTRY, TARGET, errors, 0.75, voxel_reach=0.35)
    np.testing.assert_allclose(centres.clearances - whole.clearances, 0.35, atol=1e-12)
    assert whole.hits["block"] > centres.hits["block"]


def test_ten_thousand_errors_take_less_than_two_seconds():
    plan = planned()
    errors = to_image_axes(printed_absolute().sample(10_000, 0), plan.entry, plan.target)
    warm()
    begun = time.perf_counter()
    found = collision_probability(plan.around.keep, plan.entry, plan.target, errors, 0.75)
    assert time.perf_counter() - begun < 2
    assert found.clearances.shape == (10_000, len(plan.around.keep))


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({"errors": np.zeros((5, 3))}, InputError),
        ({"errors": np.zeros((0, 2, 3))}, InputError),
        ({"errors": np.full((5, 2, 3), np.nan)}, InputError),
        ({"drill_radius": 0.0}, InputError),
        ({"drill_radius": np.nan}, InputError),
        ({"structures": {}}, InputError),
        ({"structures": {"nothing": np.zeros((0, 3))}}, InputError),
        ({"structures": {"flat": np.zeros((4, 2))}}, InputError),
        ({"entry": [1.0, 2.0]}, InputError),
        ({"entry": TARGET}, GeometryError),
        ({"voxel_reach": -1.0}, InputError),
    ],
)
def test_bad_collision_input_is_named(change, wrong):
    given = {
        "structures": {"one": np.zeros((1, 3))},
        "entry": ENTRY,
        "target": TARGET,
        "errors": np.zeros((5, 2, 3)),
        "drill_radius": 0.75,
    }
    with pytest.raises(wrong, match=next(iter(change)).split("_")[0]):
        collision_probability(**{**given, **change})


# Axes, transforms, models

coordinates = st.floats(-30, 30)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)
small = st.floats(-2, 2)
line_errors = st.lists(small, min_size=6, max_size=6).map(lambda v: np.array(v).reshape(1, 2, 3))


@settings(deadline=None, max_examples=60)
@given(entry=points, target=points, errors=line_errors)
def test_transforms_carry_the_line_to_the_erring_line(entry, target, errors):
    length = np.linalg.norm(target - entry)
    if length < 8:
        return
    (T,) = transforms(errors, entry, target)
    erring_target, erring_entry = target + errors[0, 1], entry + errors[0, 0]
    np.testing.assert_allclose(T[:3, :3] @ target + T[:3, 3], erring_target, atol=1e-9)
    direction = (erring_target - erring_entry) / np.linalg.norm(erring_target - erring_entry)
    np.testing.assert_allclose(T[:3, :3] @ entry + T[:3, 3], erring_target - length * direction, atol=1e-7)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    # The shortest turn is about an axis across the line: its angle is that between the lines.
    angle = np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))
    between = np.arccos(np.clip(direction @ (target - entry) / length, -1, 1))
    assert angle == pytest.approx(between, abs=1e-6)


def test_no_error_moves_nothing_and_a_shift_turns_nothing():
    T = transforms(np.array([np.zeros((2, 3)), np.full((2, 3), 0.4)]), ENTRY, TARGET)
    np.testing.assert_allclose(T[0], np.eye(4), atol=1e-15)
    np.testing.assert_allclose(T[1, :3, :3], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(T[1, :3, 3], 0.4, atol=1e-12)


def test_a_line_turned_round_is_refused():
    backwards = np.array([[2 * (TARGET - ENTRY), np.zeros(3)]])
    with pytest.raises(GeometryError, match=r"errors\[0\]"):
        transforms(backwards, ENTRY, TARGET)


@pytest.mark.parametrize("entry", [(-30, 1, 2), (3, -25, 4), (0, 0.1, 40)])
@pytest.mark.parametrize("roll", [0.0, 0.7])
def test_the_drills_axes_are_right_handed_with_z_along_the_bit(entry, roll):
    axes = drill_axes(entry, np.zeros(3), roll)
    np.testing.assert_allclose(axes.T @ axes, np.eye(3), atol=1e-12)
    assert np.linalg.det(axes) == pytest.approx(1)
    np.testing.assert_allclose(axes[:, 2], -np.array(entry) / np.linalg.norm(entry), atol=1e-12)
    errors = np.array([[[0, 0, 1.0], [0, 0, -2.0]]])
    np.testing.assert_allclose(
        to_image_axes(errors, entry, np.zeros(3), roll)[0], np.outer([1, -2], axes[:, 2]), atol=1e-12
    )


def test_drill_axes_are_level_where_they_can_be():
    axes = drill_axes((-30, 10, 5), np.zeros(3))
    assert axes[2, 0] == pytest.approx(0, abs=1e-12)
    assert axes[2, 1] > 0


def test_normal_errors_have_the_moments_they_are_given():
    model = NormalErrors((0.1, 0.2, 0.3), 0.4, 0.5, [[1, 0, 0], [0, -1, 0]])
    drawn = model.sample(100_000, 5)
    np.testing.assert_allclose(drawn.mean(axis=0), model.bias, atol=0.01)
    np.testing.assert_allclose(drawn.std(axis=0), [[0.1, 0.2, 0.3], [0.4] * 3], rtol=0.02)
    for axis in range(3):
        assert np.corrcoef(drawn[:, 0, axis], drawn[:, 1, axis])[0, 1] == pytest.approx(0.5, abs=0.02)
    assert (model.sample(10, 1) == model.sample(10, 1)).all()


def test_printed_errors_are_those_of_the_tables():
    lateral = printed_lateral("vanderbilt")
    rows = published.table("Baron 1").set_index(["system", "side"])
    assert lateral.bias[0, 0] == rows.loc[("vanderbilt", "top"), "mean_x_mm"]
    assert lateral.target_std[1] == rows.loc[("vanderbilt", "bottom"), "std_y_mm"]
    absolute = published.table("Baron absolute accuracy").set_index("measure")
    drawn = printed_absolute().sample(200_000, 0)[:, 1]
    for measure, axes in (
        ("drilled_target_to_desired_target_distance", [0, 1, 2]),
        ("mid_axis_to_mid_axis_distance_at_target", [0, 1]),
    ):
        mean, std = absolute.loc[measure, ["mean_mm", "std_mm"]]
        assert (drawn[:, axes] ** 2).sum(axis=1).mean() == pytest.approx(mean**2 + std**2, rel=0.02)
    with pytest.raises(InputError, match="hannover"):
        printed_lateral("jena")


def test_drawn_errors_come_each_once_before_any_comes_twice():
    errors = np.arange(60.0).reshape(10, 2, 3)
    drawn = DrawnErrors(errors)
    assert sorted(drawn.sample(10, 0)[:, 0, 0]) == sorted(errors[:, 0, 0])
    assert drawn.sample(25, 0).shape == (25, 2, 3)


def test_fitted_errors_have_the_moments_of_what_they_are_fitted_to():
    rng = np.random.default_rng(8)
    found = rng.standard_normal((300, 6)) @ rng.normal(0, 0.2, (6, 6)).T + rng.normal(0, 0.3, 6)
    found[:, 2] = 0.0  # no error along the line where the drill enters
    model = FittedErrors.of(found.reshape(-1, 2, 3))
    drawn = model.sample(200_000, 1).reshape(-1, 6)
    np.testing.assert_allclose(drawn.mean(axis=0), found.mean(axis=0), atol=0.005)
    np.testing.assert_allclose(np.cov(drawn.T), np.cov(found.T), atol=0.005)
    for wrong in (-np.eye(6), np.triu(np.ones((6, 6))), np.eye(5)):
        with pytest.raises(InputError, match="covariance"):
            FittedErrors(np.zeros((2, 3)), wrong)


def test_any_roll_turns_entry_and_target_together():
    model = NormalErrors(0.0, 0.0, 1.0, [[0.5, 0, 0.1], [0, 0.4, 0.2]])
    drawn = AnyRoll(model).sample(20_000, 2)
    np.testing.assert_allclose(np.hypot(drawn[:, 0, 0], drawn[:, 0, 1]), 0.5)
    np.testing.assert_allclose(
        drawn[:, 0, 0] * drawn[:, 1, 0] + drawn[:, 0, 1] * drawn[:, 1, 1], 0, atol=1e-12
    )
    np.testing.assert_allclose(drawn[:, :, 2], np.broadcast_to([0.1, 0.2], (20_000, 2)))
    np.testing.assert_allclose(drawn[:, :, :2].mean(axis=0), 0, atol=0.02)


def test_image_axes_and_back():
    errors = np.random.default_rng(0).normal(size=(7, 2, 3))
    there = to_image_axes(errors, ENTRY, TARGET, 0.3)
    np.testing.assert_allclose(to_drill_axes(there, ENTRY, TARGET, 0.3), errors, atol=1e-12)


# Targets and surroundings


def test_the_target_lies_on_the_labyrinth_right_below_the_oval_window():
    bone = specimen("CH01")
    window, target = oval_window(bone.anatomy), round_window_target(bone.anatomy)
    assert structure_mask(bone.anatomy, "labyrinth")[
        tuple(np.rint(bone.anatomy.indices(target[None])[0]).astype(int))
    ]
    assert target[2] <= window[2] - 2
    assert np.linalg.norm(target - window) < 4
    # The rule needs no label for the stapes.
    names, labels = dict(bone.anatomy.names), bone.anatomy.labels.copy()
    for name in ("malleus", "incus", "stapes"):
        labels[labels == names.pop(name)] = 30
    merged = LabelVolume(labels, bone.anatomy.affine, {**names, "ossicles": 30})
    assert (round_window_target(merged) == target).all()


def test_the_labyrinth_is_divided_and_shared_labels_are_one_structure():
    bone = specimen("TB14").anatomy
    around = surroundings(bone)
    whole = np.count_nonzero(structure_mask(bone, "labyrinth"))
    assert len(around.opening) + len(around.keep["labyrinth"]) == whole
    assert np.linalg.norm(around.opening - around.target, axis=1).max() <= 2
    names = dict(bone.names)
    labels = bone.labels.copy()
    labels[labels == names.pop("dura")] = names["sigmoid_sinus"]
    names["sinus_dura"] = names.pop("sigmoid_sinus")
    shared = surroundings(LabelVolume(labels, bone.affine, names))
    assert "sigmoid_sinus_and_dura" in shared.keep
    assert shared.acceptable["sigmoid_sinus_and_dura"] == 0.01
    assert around.missing == ("vestibular_aqueduct",)


def without(name):
    bone = specimen("TB14").anatomy
    labels = bone.labels.copy()
    labels[labels == bone.names[name]] = bone.names["bone"]
    return LabelVolume(labels, bone.affine, {k: v for k, v in bone.names.items() if k != name})


@pytest.mark.parametrize("name", ["facial_nerve", "labyrinth"])
def test_a_structure_that_is_needed_is_asked_for(name):
    with pytest.raises(LabelError, match=name):
        plan_access(without(name), target=round_window_target(specimen("TB14").anatomy), side="right")


def test_without_ossicles_a_target_has_to_be_given():
    bone = specimen("TB14").anatomy
    names = {k: v for k, v in bone.names.items() if k not in ("malleus", "incus", "stapes")}
    keep = np.isin(bone.labels, list(names.values()))
    bare = LabelVolume(np.where(keep, bone.labels, 0), bone.affine, names)
    with pytest.raises(LabelError, match="ossicles"):
        plan_access(bare)
    plan_access(bare, round_window_target(bone), FEW).verify()


def test_a_target_far_from_the_labyrinth_is_refused():
    with pytest.raises(GeometryError, match="target"):
        plan_access(specimen("TB14").anatomy, target=[0.0, 0.0, -20.0])


# Plans


def test_a_plan_passes_between_the_nerves_and_touches_nothing():
    plan = planned()
    plan.verify()
    offsets = []
    for name in ("facial_nerve", "chorda_tympani"):
        voxels = plan.anatomy.points(np.argwhere(structure_mask(plan.anatomy, name)))
        assert segment_distances(voxels, plan.entry, plan.target).min() > plan.settings.drill_radius
        nearest = voxels[np.argmin(segment_distances(voxels, plan.entry, plan.target))]
        along = (nearest - plan.entry) @ plan.direction
        assert 0 < along < plan.length_mm
        offsets.append(nearest - plan.entry - along * plan.direction)
    cosine = offsets[0] @ offsets[1] / np.linalg.norm(offsets[0]) / np.linalg.norm(offsets[1])
    assert cosine <= -0.5
    gap = sum(np.linalg.norm(offset) for offset in offsets)
    assert plan.recess_width == pytest.approx(gap - plan.anatomy.spacing.mean())


def test_the_drill_enters_where_the_bone_ends():
    plan = planned()
    bone = structure_mask(plan.anatomy, "bone")

    def is_bone(point):
        return bone[tuple(np.rint(plan.anatomy.indices(point[None])[0]).astype(int))]

    assert is_bone(plan.entry)
    assert not any(is_bone(plan.entry - step * plan.direction) for step in np.arange(0.3, 8, 0.1))
    assert (plan.entry - plan.target) @ lateral_direction(plan.side) > 10


def test_the_plan_is_that_of_least_simulated_damage_and_repeats_itself():
    plan = planned()
    simulated = plan.candidates["simulated_damage"].dropna()
    assert len(simulated) == FEW.simulated
    assert plan.expected_damage == pytest.approx(simulated.min())
    weights = {name: 1 / share for name, share in plan.around.acceptable.items()}
    assert plan.expected_damage == pytest.approx(
        sum(weights[name] * share for name, share in plan.risks.probabilities.items())
    )
    again = plan_access(specimen("TB14").anatomy, settings=FEW, errors=NormalErrors(0.15, 0.15))
    assert (again.entry == plan.entry).all()
    assert (again.risks.clearances == plan.risks.clearances).all()
    pd.testing.assert_frame_equal(again.candidates, plan.candidates)


def test_no_other_line_through_the_recess_does_much_less_damage():
    plan = planned("TB14", 0.4)
    free = plan.candidates[[f"{name}_mm" for name in plan.risks.names]].min(axis=1) > 0
    rows = plan.candidates[free].sample(25, random_state=0)
    drawn = plan.model.sample(FEW.samples, np.random.default_rng(0))
    for _, row in rows.iterrows():
        entry = row[["entry_x_mm", "entry_y_mm", "entry_z_mm"]].to_numpy(float)
        errors = to_image_axes(drawn, entry, plan.target)
        risks = collision_probability(plan.around.keep, entry, plan.target, errors, FEW.drill_radius)
        damage = sum(share / plan.around.acceptable[name] for name, share in risks.probabilities.items())
        assert damage >= 0.9 * plan.expected_damage


def test_a_mirrored_bone_has_the_mirrored_lines():
    bone = specimen("TB14").anatomy
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    other = LabelVolume(bone.labels, mirror @ bone.affine, bone.names)
    left = plan_access(other, settings=FEW, errors=NormalErrors(0.15, 0.15))
    assert (planned().side, left.side) == ("right", "left")
    same = ["posterior_deg", "superior_deg", "recess_width_mm", "facial_nerve_mm", "entry_y_mm"]
    coarse = [plan.candidates[same].iloc[:150].to_numpy() for plan in (planned(), left)]
    np.testing.assert_allclose(*coarse, atol=1e-9)


def test_a_drill_too_thick_is_told_what_is_in_its_way():
    with pytest.raises(TargetUnreachableError, match=r"facial_nerve blocks \d+ of them"):
        plan_access(specimen("TB14").anatomy, settings=AccessSettings(drill_diameter=6.0, samples=100))


def test_a_cone_that_misses_the_recess_says_so():
    with pytest.raises(TargetUnreachableError, match="between facial_nerve and chorda_tympani"):
        plan_access(specimen("TB14").anatomy, settings=AccessSettings(fan_deg=4.0, samples=100))


def test_what_is_not_acceptable_is_said_or_refused():
    bone = specimen("TB14").anatomy
    plan = plan_access(bone, settings=FEW)
    assert "facial_nerve" in plan.too_probable
    assert not plan.acceptable
    assert plan.table().loc["facial_nerve", "accepted"] == 0.001
    with pytest.raises(PlanningError, match="facial_nerve with"):
        plan_access(bone, settings=FEW, acceptable_only=True)
    better = plan_access(bone, settings=FEW, errors=NormalErrors(0.05, 0.05), acceptable_only=True)
    assert better.acceptable
    assert better.reached.risk == 1


def test_a_chorda_that_may_be_sacrificed_leaves_the_facial_nerve_more_room():
    bone, errors = specimen("TB14").anatomy, NormalErrors(0.4, 0.4)
    settings = AccessSettings(samples=1500, simulated=4, refined=2, sacrificed=("chorda_tympani",))
    kept = plan_access(bone, settings=FEW, errors=errors)
    given_up = plan_access(bone, settings=settings, errors=errors)
    assert given_up.expected_damage < kept.expected_damage
    assert given_up.clearances["facial_nerve"] > kept.clearances["facial_nerve"]
    assert "chorda_tympani" not in given_up.too_probable
    given_up.verify()


def test_whole_voxels_make_a_plan_more_cautious():
    bone, errors = specimen("CH01").anatomy, NormalErrors(0.05, 0.05)
    whole = plan_access(
        bone,
        settings=AccessSettings(samples=1500, simulated=4, refined=2, voxels="whole", drill_diameter=1.0),
        errors=errors,
    )
    whole.verify()
    centres = collision_probability(whole.around.keep, whole.entry, whole.target, whole.risks.errors, 0.5)
    assert (centres.planned > whole.risks.planned).all()


def test_other_errors_on_the_same_hole_and_an_array_is_used_as_it_is():
    plan = planned()
    array = printed_lateral("hannover").sample(300, 4)
    other = plan.with_errors(array)
    assert len(other.risks.errors) == 300
    np.testing.assert_allclose(other.risks.errors, to_image_axes(array, plan.entry, plan.target))
    assert (other.entry == plan.entry).all()
    for wrong in (None, "hannover", NormalErrors, np.zeros((3, 3))):
        with pytest.raises(InputError, match="errors"):
            plan.with_errors(wrong)


def test_verification_notices_a_changed_plan():
    plan = planned()
    moved = type(plan)(**{**vars(plan), "entry": plan.entry + np.array([0, 2.0, 0])})
    with pytest.raises(GuidanceError, match="clearance"):
        moved.verify()


@pytest.mark.parametrize(
    "change",
    [
        {"drill_diameter": 0},
        {"opening": 3.0},
        {"fan_deg": 90},
        {"voxels": "corner"},
        {"samples": 0},
        {"acceptable": {"facial_nerve": 0.001}},
        {"acceptable": {"facial_nerve": 0.001, "labyrinth": 0.01, "spleen": 0.5}},
        {"acceptable": {"facial_nerve": 1.0, "labyrinth": 0.01}},
        {"sacrificed": ("facial_nerve",)},
        {"recess_angle_deg": 30},
    ],
)
def test_bad_settings_are_named(change):
    name = "below_oval_window" if "opening" in change else next(iter(change))
    with pytest.raises(InputError, match=name):
        AccessSettings(**change)


# How accurate


def test_the_required_accuracy_is_where_the_risk_crosses_the_probability():
    plan = planned("TB14", 0.4)
    found = required_std(plan, "facial_nerve", 0.01)
    assert found.estimate.risk <= 0.01
    beyond = risk_curve(plan, [1.01 * found.scale])["probability"].iloc[0]
    assert beyond > 0.01 - 2 / FEW.samples
    assert found.target_std == pytest.approx(found.scale * rms_across(plan.risks.errors, plan.direction)[1])
    assert found.target_std == pytest.approx(found.scale * 0.4, rel=0.05)


def test_the_required_accuracy_of_a_flat_wall_is_the_normal_quantile():
    plan = planned()
    # A wall beside the planned drill, everywhere at the same distance.
    axes = drill_axes(plan.entry, plan.target)
    flat = wall(0.0)[:, [1, 2, 0]] + [1.55, 0, 15]
    around = type(plan.around)(
        plan.target,
        {"wall": flat @ axes.T + plan.entry},
        {},
        plan.around.opening,
        {"wall": 0.01},
        (),
    )
    other = type(plan)(**{**vars(plan), "around": around})
    other = type(other)(**{**vars(other), "settings": AccessSettings(samples=20_000)})
    other = other.with_errors(NormalErrors((0.2, 0, 0), (0.2, 0, 0)))
    found = required_std(other, "wall", 0.01)
    assert 0.2 * found.scale == pytest.approx((1.55 - 0.75) / stats.norm.isf(0.01), rel=0.04)
    curve = risk_curve(other, [0, 0.5, 1, 2], ("wall",))
    assert curve["probability"].is_monotonic_increasing
    assert curve["probability"].iloc[0] == 0


def test_required_accuracy_refuses_what_so_many_errors_cannot_tell():
    with pytest.raises(InputError, match="probability"):
        required_std(planned(), probability=1e-5)
    with pytest.raises(LabelError, match="spleen"):
        required_std(planned(), "spleen")
    with pytest.raises(InputError, match="scales"):
        risk_curve(planned(), [-1.0])


# Safety margins from the same errors


def test_a_margin_grown_from_the_drills_errors_protects_more_than_the_drill_needs():
    names = {"air": 0, "bone": 1, "nerve": 2}
    labels = np.ones((40, 30, 30), np.uint8)
    affine = np.diag([0.4, 0.4, 0.4, 1.0])
    labels[24:27, 14:17] = 2
    volume = LabelVolume(labels, affine, names)
    nerve = volume.points(np.argwhere(labels == 2))
    entry, target = np.array([0.0, 1.5, 6.0]), np.array([15.0, 1.5, 6.0])
    model = NormalErrors(0.25, 0.25)
    source = LineErrors(model, entry, target)
    assert isinstance(source, ErrorSource)
    settings = GrowthSettings(registrations=2000, validation_registrations=2000)
    margin = grow_margin(volume, "nerve", source, 0.01, settings=settings, rng=0)
    errors = to_image_axes(model.sample(4000, 9), entry, target)
    spared = {
        "nerve": nerve,
        "margin": volume.points(np.argwhere(margin.mask)),
    }
    found = collision_probability(spared, entry, target, errors, 1.2)
    if found.planned[1] > 0.35:  # half a voxel's diagonal: no part of a voxel of the margin is milled
        assert found.risk("nerve").interval[0] <= 0.01
    else:
        pytest.fail(f"the drill was meant to stay out of the margin: {found.planned}")
    assert margin.validation.risk <= 0.012


# Real bones


@pytest.mark.parametrize("name", ["RT143", "LT143", "LT151"])
def test_real_bones_have_a_way_through_the_facial_recess(name):
    bone = read_temporal_bone_case(real(f"temporal_bone/{name}"))
    plan = plan_access(bone.anatomy, settings=FEW, errors=NormalErrors(0.1, 0.1))
    plan.verify()
    assert plan.side == bone.side
    # Baron, 2: about 2 mm between the nerves, the cochlea about 35 mm deep.
    assert 1.5 < plan.recess_width < 3.5
    assert 20 < plan.length_mm < 40
    assert plan.reached.risk == 1
    assert "sigmoid_sinus_and_dura" in plan.clearances
    # Behind the ear canal, and no steeper than the mastoid's surface is wide.
    canal = bone.anatomy.points(np.argwhere(structure_mask(bone.anatomy, "external_auditory_canal")))
    assert plan.entry[1] > canal[:, 1].mean()
