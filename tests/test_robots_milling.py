"""Feed rate, milling time and joint trajectories."""

import numpy as np
import pandas as pd
import pytest
from fake_plans import fake_plan, random_walk
from hypothesis import given, settings
from hypothesis import strategies as st

from study.errors import InputError
from study.robots import (
    Ansr,
    FeedSettings,
    FiveAxis,
    RoundingSettings,
    fit_feed_constant,
    predict_milling,
    relative_density,
)
from study.robots.feed import weighted_removal
from study.robots.feed_laws import LAWS
from study.robots.turns import angles_between


def busy_plan(seed, steps=300, labels=None):
    rng = np.random.default_rng(seed)
    walk = random_walk(rng, steps)
    walk = np.repeat(
        walk, 1 + (rng.random(len(walk)) < 0.05), axis=0
    )  # some points twice: rotations in place
    removed = rng.exponential(1.0, len(walk)) * (rng.random(len(walk)) < 0.4)
    removed[0] = 0
    tilt = np.cumsum(rng.normal(0, 0.03, len(walk)) * (rng.random(len(walk)) < 0.5))
    return fake_plan(walk, labels, removed=removed, tilt=0.7 * np.sin(tilt))


def test_air_is_crossed_at_five_mm_a_second():
    plan = fake_plan([[12, 12, 12 + i] for i in range(26)])
    milling = predict_milling(plan)
    assert milling.path_length_mm == pytest.approx(10.0)
    assert milling.time_s == pytest.approx(2.0)
    assert milling.mean_speed_mm_per_s == pytest.approx(5.0)
    assert list(milling.summary().index) == [
        "milling_path_length_mm",
        "predicted_milling_time_s",
        "average_milling_speed_mm_per_s",
    ]


def test_bone_is_removed_at_the_removal_rate_between_the_limits():
    feed = FeedSettings(removal_rate=4.0)
    speeds = feed.speeds(np.array([0.0, 0.4, 0.8, 2.0, 100.0, 1.0]), np.array([0.4, 0.4, 0.4, 0.4, 0.4, 0.0]))
    np.testing.assert_allclose(speeds, [5, 4, 2, 0.8, 0.5, 5])


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), rate=st.floats(0.1, 100))
def test_speeds_stay_within_the_limits_and_a_stronger_drill_is_never_slower(seed, rate):
    plan = busy_plan(seed, 120)
    milling = predict_milling(plan, feed=FeedSettings(removal_rate=rate))
    assert milling.speeds.min() >= 0.5
    assert milling.speeds.max() <= 5.0
    assert milling.mean_speed_mm_per_s <= 5.0
    stronger = predict_milling(plan, feed=FeedSettings(removal_rate=2 * rate))
    assert stronger.time_s <= milling.time_s + 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_time_is_the_sum_of_its_parts(seed):
    plan, feed = busy_plan(seed), FeedSettings(removal_rate=3.0)
    robot = Ansr.for_plan(plan, max_tilt_speed_deg=15.0)
    milling = predict_milling(plan, robot, feed)
    total = 0.0
    for i in range(1, len(plan.points)):
        way = milling.path.rounded_s[i] - milling.path.rounded_s[i - 1]
        speed = 5.0
        if plan.removed[i] > 0 and way > 0:
            speed = min(max(3.0 / (plan.removed[i] / way), 0.5), 5.0)
        cosine = np.clip(plan.axes[i] @ plan.axes[i - 1], -1, 1)
        sine = np.linalg.norm(np.cross(plan.axes[i], plan.axes[i - 1]))
        total += max(way / speed, np.rad2deg(np.arctan2(sine, cosine)) / 15.0)
    assert milling.time_s == pytest.approx(total, rel=1e-9)
    assert 0 < milling.rotation_time_s < total


@pytest.mark.parametrize("seed", range(3))
def test_the_trajectory_follows_the_rounded_path_on_time(seed):
    plan = busy_plan(seed)
    milling = predict_milling(plan)
    track = milling.trajectory
    assert track.duration_s == pytest.approx(milling.time_s)
    assert (np.diff(track.time_s) >= -1e-12).all()
    points, _ = milling.robot.forward(track.joints)
    np.testing.assert_allclose(points, track.points, atol=1e-9)
    # Chords of the sampled arcs are shorter than the arcs, by no more than a quarter of a percent of them.
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert length <= milling.path_length_mm + 1e-9
    assert length >= milling.path_length_mm * 0.99
    # No sample is faster than the feed rate or the rotation allows.
    time = np.diff(track.time_s)
    moved = np.linalg.norm(np.diff(points, axis=0), axis=1)
    turned = np.rad2deg(np.abs(np.diff(track.joints[:, 3])))
    assert (moved <= 5 * time + 1e-9).all()
    assert (turned <= milling.robot.max_tilt_speed_deg * time + 1e-9).all()
    # At planned points that no arc passes by, the drill stands as planned.
    clock = np.concatenate([[0.0], np.cumsum(milling.step_times)])
    at = milling.robot.forward(track.at(clock))
    near = np.linalg.norm(at[0] - plan.points, axis=1)
    assert near.max() <= 0.5 * 0.4 + 1e-6
    stays = near < 1e-9
    stays[:-1] &= np.diff(clock) > 0
    assert stays.sum() > 50
    np.testing.assert_allclose(at[1][stays], plan.axes[stays], atol=1e-6)


def leaning_plan(seed):
    """A busy plan whose drill also leaves the plane, in place and on the way, at most 5 degrees a step."""
    plan = busy_plan(seed)
    rng = np.random.default_rng(seed)
    n = len(plan.points)
    tilt, lean = np.cumsum(rng.uniform(-0.08, 0.08, (2, n)) * (rng.random(n) < 0.5), axis=1)
    robot = FiveAxis.for_plan(plan)
    joints = np.column_stack([np.zeros((n, 3)), 0.7 * np.sin(tilt), 0.7 * np.cos(lean)])
    object.__setattr__(plan, "axes", robot.forward(joints)[1])
    object.__setattr__(plan, "dof", 5)
    return plan


@pytest.mark.parametrize("seed", range(3))
def test_five_joints_follow_the_plan_on_great_circles(seed):
    plan = leaning_plan(seed)
    milling = predict_milling(plan)
    assert isinstance(milling.robot, FiveAxis)
    track = milling.trajectory
    assert list(track.to_frame())[:6] == ["time_s", "x_mm", "y_mm", "z_mm", "tilt_deg", "lean_deg"]
    assert track.duration_s == pytest.approx(milling.time_s)
    time = np.diff(track.time_s)
    turned = np.rad2deg(np.abs(np.diff(track.joints[:, 3:], axis=0))).max(axis=1)
    standing = np.linalg.norm(np.diff(track.points, axis=0), axis=1) < 1e-12
    assert (turned[standing] <= milling.robot.max_tilt_speed_deg * time[standing] + 1e-6).all()
    assert standing.sum() > 10
    # Joints that turn evenly between the samples stay on the circle that was planned and is replayed.
    fine = np.linspace(0, track.duration_s, 40000)
    axes = milling.robot.forward(track.at(fine))[1]
    clock = np.concatenate([[0.0], np.cumsum(milling.step_times)])
    step = np.clip(np.searchsorted(clock, fine, side="right") - 1, 0, len(plan.points) - 2)
    start, end = plan.axes[step], plan.axes[step + 1]
    pole = np.cross(start, end)
    turn = np.linalg.norm(pole, axis=1)
    aside = np.abs(np.einsum("ij,ij->i", axes, pole)[turn > 1e-3] / turn[turn > 1e-3])
    assert aside.max() < 5e-5  # a degree's share of it; cut nowhere they leave it four times as far
    assert angles_between(start, axes)[turn == 0].max() < 1e-6


def test_a_plan_of_four_degrees_of_freedom_takes_five_axes_as_long():
    plan = busy_plan(4)
    five = predict_milling(plan, FiveAxis.for_plan(plan))
    assert five.time_s == pytest.approx(predict_milling(plan).time_s, rel=1e-12)


def test_the_trajectory_goes_to_a_file(tmp_path):
    milling = predict_milling(busy_plan(1))
    milling.trajectory.to_csv(tmp_path / "joints.csv")
    table = pd.read_csv(tmp_path / "joints.csv")
    assert list(table) == [
        "time_s",
        "x_mm",
        "y_mm",
        "z_mm",
        "tilt_deg",
        "burr_x_mm",
        "burr_y_mm",
        "burr_z_mm",
    ]
    assert len(table) == len(milling.trajectory.time_s)
    np.testing.assert_allclose(np.deg2rad(table["tilt_deg"]), milling.trajectory.joints[:, 3], atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == ["joints.csv"]


def test_without_rounding_the_planned_length_is_milled():
    plan = busy_plan(2)
    milling = predict_milling(plan, rounding=RoundingSettings(corner_tolerance=0.0))
    assert milling.path_length_mm == pytest.approx(np.linalg.norm(np.diff(plan.points, axis=0), axis=1).sum())
    assert predict_milling(plan).path_length_mm < milling.path_length_mm


def bone_block(seed):
    rng = np.random.default_rng(seed)
    labels = np.zeros((40, 40, 40), np.uint8)
    labels[8:32, 8:32, 8:32] = rng.choice([0, 1, 2], size=(24, 24, 24), p=[0.2, 0.1, 0.7])
    return labels


def test_weighed_removal_replays_the_burr():
    labels, rng = bone_block(0), np.random.default_rng(1)
    plan = fake_plan(random_walk(rng, 40), labels, burr_radius=1.3)
    density = rng.uniform(0, 2, labels.shape)
    grid = np.stack(np.meshgrid(*[np.arange(40)] * 3, indexing="ij"), axis=-1)
    left, expected = labels == 2, []
    places = plan.modified.volume.indices(plan.points)
    for before, after in zip(np.vstack([places[:1], places]), places, strict=False):
        cut = np.zeros_like(left)
        for share in np.linspace(0, 1, 11):  # the burr sweeps the way from one point to the next
            gap = np.maximum(np.abs(grid - before - share * (after - before)) - 0.5, 0) * 0.4
            cut |= left & ((gap**2).sum(axis=-1) < 1.3**2)
        expected.append(density[cut].sum() * 0.4**3)
        left &= ~cut
    np.testing.assert_allclose(weighted_removal(plan, density), expected, rtol=1e-12)


def test_denser_bone_takes_longer():
    labels = bone_block(2)
    plan = fake_plan(random_walk(np.random.default_rng(3), 200), labels, burr_radius=1.3)
    soft = predict_milling(plan, density=np.full(labels.shape, 0.5))
    hard = predict_milling(plan, density=np.full(labels.shape, 1.5))
    none = predict_milling(plan, density=np.zeros(labels.shape))
    assert none.time_s < soft.time_s < hard.time_s
    assert none.mean_speed_mm_per_s == pytest.approx(5.0)


def test_hounsfield_units_become_relative_density():
    np.testing.assert_allclose(relative_density(np.array([-1000, 0, 750, 1500, 3000])), [0, 0, 0.5, 1, 2])
    with pytest.raises(InputError, match="bone"):
        relative_density(np.zeros(3), bone=0)


def test_the_feed_constant_is_recovered_from_the_speed_it_gives():
    millings = [predict_milling(busy_plan(seed), feed=FeedSettings(removal_rate=2.7)) for seed in range(3)]
    speed = np.mean([milling.mean_speed_mm_per_s for milling in millings])
    motions = [milling.motion for milling in millings]
    assert fit_feed_constant(motions, speed) == pytest.approx(2.7, rel=1e-6)
    with pytest.raises(InputError, match="printed_mean_speed"):
        fit_feed_constant(motions, 5.5)
    with pytest.raises(InputError, match="motions"):
        fit_feed_constant([], 3.7)


@pytest.mark.parametrize("law", LAWS.values(), ids=list(LAWS))
def test_every_law_keeps_the_limits_slows_down_in_bone_and_can_be_fitted(law):
    amounts = np.linspace(0, 50, 200)
    speeds = law(removal_rate=2.0).speeds(amounts, np.ones(200))
    assert speeds[0] == 5.0
    assert speeds.min() >= 0.5
    assert speeds[-1] < 5.0
    assert (np.diff(speeds) <= 1e-12).all()
    motions = [predict_milling(busy_plan(seed)).motion for seed in range(2)]
    target = np.mean([motion.mean_speed(law(removal_rate=1.7)) for motion in motions])
    assert fit_feed_constant(motions, target, law()) == pytest.approx(1.7, rel=1e-6)


@pytest.mark.parametrize(
    "values", [{"min_speed": 0.0}, {"min_speed": 6.0}, {"removal_rate": -1.0}, {"max_speed": np.inf}]
)
def test_bad_feed_settings_are_refused(values):
    with pytest.raises(InputError, match="FeedSettings"):
        FeedSettings(**values)


def test_bad_densities_and_removals_are_refused():
    plan = busy_plan(0)
    with pytest.raises(InputError, match="shape"):
        predict_milling(plan, density=np.ones((2, 2, 2)))
    with pytest.raises(InputError, match="relative_density"):
        predict_milling(plan, density=np.full(plan.modified.volume.shape, -1.0))
    object.__setattr__(plan, "removed", -np.ones(len(plan.points)))
    with pytest.raises(InputError, match="removed"):
        predict_milling(plan)
