import pickle
from functools import reduce

import numpy as np
import pytest
from arm_cases import pose_error, shifted, turned
from scipy.spatial.transform import Rotation

from study.errors import FileFormatError, InputError, ReachError
from study.robots.arms import chain, guided_arm
from study.robots.arms.inverse import REGULAR

#: As the maker's manual prints them for series 3, m and rad, typed in apart from the package's table.
D = (0.089159, 0, 0, 0.10915, 0.09465, 0.08230)
A = (0, -0.42500, -0.39225, 0, 0, 0)
ALPHA = (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0)
X, Z = (1, 0, 0), (0, 0, 1)


def by_hand(q, d=D):
    steps = [
        turned(Z, q[k]) @ shifted(0, 0, 1e3 * d[k]) @ shifted(1e3 * A[k], 0, 0) @ turned(X, ALPHA[k])
        for k in range(6)
    ]
    return reduce(np.matmul, steps)


@pytest.fixture
def ur5():
    return guided_arm("UR5")


def test_forward_is_the_product_of_denavit_and_hartenberg(ur5):
    rng = np.random.default_rng(1)
    for q in rng.uniform(*ur5.limits.T, (100, 6)):
        np.testing.assert_allclose(ur5.forward(q), by_hand(q), rtol=0, atol=1e-10)
    many = rng.uniform(*ur5.limits.T, (4, 6))
    assert np.array_equal(ur5.forward(many), [ur5.forward(q) for q in many])


def test_forward_is_the_published_urdf(ur5):
    """Joints of ur_description's default kinematics: places in mm, roll, pitch and yaw, each about its z."""
    places = [(0, 0, 89.159), (0, 0, 0), (-425, 0, 0), (-392.25, 0, 109.15), (0, -94.65, 0), (0, 82.3, 0)]
    rolls = [(0, 0, 0), (90, 0, 0), (0, 0, 0), (0, 0, 0), (90, 0, 0), (90, 180, 180)]
    for q in np.random.default_rng(2).uniform(-3, 3, (20, 6)):
        T = np.eye(4)
        for place, rpy, angle in zip(places, rolls, q, strict=True):
            roll = np.eye(4)
            roll[:3, :3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix()
            T = T @ shifted(*place) @ roll @ turned(Z, angle)
        np.testing.assert_allclose(ur5.forward(q), T, atol=1e-9)


def test_the_other_published_geometry_is_0_3_mm_higher(ur5):
    toolbox = (0.089459, *D[1:])
    for q in np.random.default_rng(3).uniform(-3, 3, (20, 6)):
        off = by_hand(q, toolbox) - ur5.forward(q)
        np.testing.assert_allclose(off[:3, 3], [0, 0, 0.3], atol=1e-9)
    rows = ur5.source
    said = rows[(rows["quantity"] == "d") & (rows["joint"] == 1)]["source"].item()
    assert "89.459" in said and "0.3 mm" in said


def test_jacobian_is_the_finite_difference(ur5):
    h = 1e-5
    for q in np.random.default_rng(4).uniform(-3, 3, (20, 6)):
        columns = []
        for step in h * np.eye(6):
            after, before = by_hand(q + step), by_hand(q - step)
            rotation = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
            columns.append(np.concatenate([after[:3, 3] - before[:3, 3], rotation]) / (2 * h))
        np.testing.assert_allclose(ur5.jacobian(q), np.transpose(columns), atol=1e-5)
        T, J = ur5.pose_and_jacobian(q)
        assert np.array_equal(T, ur5.forward(q)) and np.array_equal(J, ur5.jacobian(q))


def test_ready_has_the_flange_down_and_is_regular(ur5):
    T = ur5.forward(ur5.ready)
    np.testing.assert_allclose(T[:3, 2], [0, 0, -1], atol=1e-12)
    assert ur5.regularity(ur5.ready) > 10 * REGULAR
    assert (ur5.limits[:, 0] < ur5.ready).all() and (ur5.ready < ur5.limits[:, 1]).all()
    assert ur5.cycle_s == 0.008 and ur5.name == "UR5" and repr(ur5) == "ChainArm(UR5)"


def test_no_axis_is_farther_from_the_flange_than_the_reach(ur5):
    """The length of a column of the Jacobian is the distance of the flange from that joint's axis."""
    rng = np.random.default_rng(5)
    away = [np.linalg.norm(ur5.jacobian(q)[:3], axis=0).max() for q in rng.uniform(-3, 3, (5000, 6))]
    assert 0.8 * ur5.reach_mm < max(away) <= ur5.reach_mm


def test_inverse_comes_back_to_poses_all_around(ur5):
    rng = np.random.default_rng(6)
    asked = worst = 0
    while asked < 60:
        q = rng.uniform(-np.pi, np.pi, 6)
        if ur5.regularity(q) < 3 * REGULAR:
            continue
        asked += 1
        T = ur5.forward(q)
        found = ur5.inverse(T)
        assert (found >= ur5.limits[:, 0]).all() and (found <= ur5.limits[:, 1]).all()
        worst = np.maximum(worst, pose_error(T, ur5.forward(found)))
        near = ur5.inverse(T, q + rng.normal(0, 0.01, 6))
        np.testing.assert_allclose(near, q, atol=1e-8)
    assert worst[0] < 1e-6 and worst[1] < 1e-9


def test_poses_that_it_cannot_take(ur5):
    far = shifted(1500, 0, 200)
    with pytest.raises(ReachError, match=r"UR5: the nearest solution stays \d+"):
        ur5.inverse(far)
    stretched = ur5.ready.copy()
    stretched[2] = 0.0
    with pytest.raises(ReachError, match="near a singularity"):
        ur5.inverse(ur5.forward(stretched), stretched)
    with pytest.raises(InputError, match="T_rob_ee"):
        ur5.inverse(2 * np.eye(4))
    with pytest.raises(InputError, match="joint angles: expected six finite numbers"):
        ur5.inverse(np.eye(4), [1, 2, 3])


@pytest.mark.parametrize("q", [[0, 1, 2], [0, 0, 0, 0, 0, np.nan], np.zeros((2, 5)), 1.0])
def test_angles_that_are_none(ur5, q):
    for call in (ur5.forward, ur5.jacobian, ur5.pose_and_jacobian, ur5.regularity):
        with pytest.raises(InputError, match="joint angles: expected six finite numbers"):
            call(q)


def test_an_arm_that_is_not_there():
    with pytest.raises(InputError, match="expected one of UR5, got 'UR10'"):
        guided_arm("UR10")


def test_every_value_has_a_source(ur5):
    assert ur5.source["source"].str.len().min() > 10
    memory = ur5.source["source"].str.contains("from memory|our choice")
    assert memory.any() and not ur5.source[memory]["verified"].any()
    assert ur5.source[~memory]["verified"].all()
    with pytest.raises(ValueError, match="read-only"):
        ur5.limits[0, 0] = 0.0


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("UR5,d,4,109.15,mm", "UR5,d,4,0.10915,m", "one line each"),
        ("UR5,d,4,109.15,mm", "UR5,d,4,,mm", "a value, its unit"),
        ("UR5,a,6,0,mm", "UR5,a,6,5,mm", "flange on axis 6"),
    ],
)
def test_a_bad_table_is_named(old, new, message, tmp_path, monkeypatch):
    text = chain.data_path("guided_arms.csv").read_text()
    assert old in text
    bad = tmp_path / "guided_arms.csv"
    bad.write_text(text.replace(old, new))
    monkeypatch.setattr(chain, "data_path", lambda *_: bad)
    monkeypatch.setattr(chain, "_table", chain._table.__wrapped__)
    with pytest.raises(FileFormatError, match=rf"guided_arms\.csv: .*{message}"):
        guided_arm.__wrapped__("UR5")


def test_it_travels_to_another_process(ur5):
    there = ur5.forward(ur5.ready)
    assert np.array_equal(pickle.loads(pickle.dumps(ur5)).forward(ur5.ready), there)
