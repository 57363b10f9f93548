import numpy as np
import pytest
from arm_cases import both, pose_error, postures

from study.errors import InputError, ReachError
from study.robots.arms import ArmErrors, arm, follow
from study.robots.arms.inverse import REGULAR


@both
@pytest.mark.parametrize("built", [False, True])
def test_inverse_comes_back_to_500_poses(name, built):
    rng = np.random.default_rng(5)
    one = ArmErrors().built(arm(name), rng) if built else arm(name)
    worst = np.zeros(2)
    for q in postures(one, 500, rng):
        T = one.forward(q)
        found = one.inverse(T)
        assert (found >= one.limits[:, 0]).all() and (found <= one.limits[:, 1]).all()
        worst = np.maximum(worst, pose_error(T, one.forward(found)))
    assert worst[0] < 1e-6 and worst[1] < 1e-9


@both
def test_inverse_takes_the_posture_of_its_start_and_repeats(name):
    rng = np.random.default_rng(6)
    one = ArmErrors().built(arm(name), rng)
    for q in postures(one, 100, rng):
        start = q + rng.normal(0, 0.01, 6)
        found = one.inverse(one.forward(q), start)
        np.testing.assert_allclose(found, q, atol=1e-8)
        assert np.array_equal(found, one.inverse(one.forward(q), start))


@both
def test_inverse_keeps_whole_turns_of_the_last_joint(name):
    one = arm(name)
    for turns in (-1.5, 0.5, 1.5):
        q = one.ready + np.pi * np.array([0, 0, 0, 0, 0, turns])
        np.testing.assert_allclose(one.inverse(one.forward(q), q), q, atol=1e-9)


@both
def test_beyond_reach_says_by_how_much(name):
    one = arm(name)
    T = one.forward(one.ready)
    T[:3, 3] = one.data.shoulder_offset, 0.0, one.data.base_height
    T[0, 3] += one.data.upper_arm + np.hypot(*one.fore) + 7.25
    with pytest.raises(ReachError, match=rf"{name}: outside reach by 7\.250 mm"):
        one.inverse(T)
    built = ArmErrors().built(one, np.random.default_rng(0))
    with pytest.raises(ReachError, match=r"outside reach by 7\.250 mm"):
        built.inverse(T)


def test_past_a_joint_limit_says_which_and_by_how_much():
    one = arm("RV-3S")
    q = one.ready.copy()
    q[4] = one.limits[4, 1] + np.deg2rad(10)  # the other elbow and shoulder stand further beyond
    expected = (
        r"RV-3S: joint limit: joint 5 would stand at 130\.00 degrees, 10\.00 beyond its range of -120 to 120"
    )
    for start in (None, q, np.zeros(6)):
        with pytest.raises(ReachError, match=expected):
            one.inverse(one.forward(q), start)


@both
def test_poses_past_one_limit_are_taken_otherwise_or_refused(name):
    one = arm(name)
    rng = np.random.default_rng(10)
    low, high = one.limits.T
    refused = 0
    for q in postures(one, 100, rng):
        joint = rng.integers(1, 5)
        q[joint] = high[joint] + 0.2
        T = one.forward(q)
        try:
            found = one.inverse(T, q)
        except ReachError as error:
            refused += 1
            assert "joint limit: joint" in str(error) or "singularity" in str(error)
        else:
            assert (found >= low).all() and (found <= high).all()
            assert max(pose_error(T, one.forward(found))) < 1e-6
    assert 0 < refused < 100


@pytest.mark.parametrize(
    ("degrees", "which"),
    [([0, 0, 90, 0, 0.1, 0], "axes 4 and 6"), ([20, 30, 0.1, 0, 60, 0], "stretched")],
)
@both
def test_singular_poses_say_which(name, degrees, which):
    one = arm(name)
    q = one.data.senses * np.deg2rad(degrees)
    if which == "stretched":
        q[2] -= one.data.senses[2] * np.arctan2(*one.fore)
    T = one.forward(q)
    if (name, which) == ("KR3", "axes 4 and 6"):  # turned over, this arm reaches it another way
        assert one.regularity(one.inverse(T, q)) >= REGULAR
        return
    with pytest.raises(ReachError, match=rf"near a singularity, .*{which}.*regularity"):
        one.inverse(T, q)


@both
def test_the_wrist_above_axis_1_is_singular(name):
    one = arm(name)
    T = one.forward(one.ready)
    T[:3, 3] = 0.0, 1e-3, one.data.base_height + 450.0
    with pytest.raises(ReachError, match=r"singularity|joint limit"):
        one.inverse(T)


@both
def test_a_straight_line_is_followed_in_one_posture(name):
    one = ArmErrors().built(arm(name), np.random.default_rng(11))
    T = np.tile(one.forward(one.ready), (60, 1, 1))
    T[:, 2, 3] -= np.linspace(0, 120, 60)  # down, as a drill goes in
    q = follow(one, T)
    assert max(pose_error(a, b)[0] for a, b in zip(T, one.forward(q), strict=True)) < 1e-6
    assert np.abs(np.diff(q, axis=0)).max() < 0.05
    np.testing.assert_allclose(q[0], one.ready, atol=1e-8)


@both
def test_a_line_that_leaves_the_reach_says_where(name):
    one = arm(name)
    T = np.tile(one.forward(one.ready), (10, 1, 1))
    T[:, 0, 3] += np.linspace(0, 450, 10)
    wrist = T[:, :3, 3] - [one.data.shoulder_offset, 0, one.data.base_height]
    first = int(np.argmax(np.linalg.norm(wrist, axis=1) > one.data.upper_arm + np.hypot(*one.fore)))
    with pytest.raises(ReachError, match=rf"pose {first} of 10: {name}: outside reach by"):
        follow(one, T, one.ready)


def test_a_joint_that_jumps_is_told():
    one = arm("KR3")
    T = one.forward([one.ready, one.ready + 0.6 * np.eye(6)[0]])
    with pytest.raises(
        ReachError, match=r"pose 1 of 2: KR3: joint 1 would jump by 34\.4 degrees, at most 28\.6"
    ):
        follow(one, T)
    with pytest.raises(InputError, match="T_rob_ee"):
        follow(one, T[0])
