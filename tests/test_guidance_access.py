"""Linear access to the cochlea: what an erring drill touches, and how robots err."""

import time

import numpy as np
import pytest
from access_cases import ENTRY, TARGET, planned, segment_distances, wall
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from study import published
from study.errors import (
    GeometryError,
    InputError,
)
from study.guidance.access import (
    AnyRoll,
    DrawnErrors,
    FittedErrors,
    LineErrors,
    NormalErrors,
    collision_probability,
    drill_axes,
    printed_absolute,
    printed_lateral,
    to_drill_axes,
    to_image_axes,
    transforms,
    warm,
)
from study.margins import GrowthSettings, grow_margin
from study.registration.sources import ErrorSource
from study.volumes import LabelVolume

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
