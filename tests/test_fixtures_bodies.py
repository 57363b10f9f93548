"""A tool of capsules, with slack and through joints: what it keeps, and that it is the nearest motion."""

import numpy as np
import pytest
from fixture_cases import HARD, VtkDistance, closest_points, plate, rough
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.collision import Drill
from study.errors import InputError
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, SphereTool, moved
from study.fixtures.control.bodies import BodySteps
from study.fixtures.control.bodies.capsules import _kernels
from study.fixtures.optimisation import nearest_motion


def segment_distance(triangle, ends):
    """From a triangle (3, 3) to a segment (2, 3): many points of the segment, then more around the best."""
    low, high = 0.0, 1.0
    best = np.inf
    for _ in range(6):
        s = np.linspace(low, high, 41)
        gaps = [
            np.linalg.norm(p - closest_points(triangle[None], p)[0])
            for p in ends[0] + s[:, None] * (ends[1] - ends[0])
        ]
        k = int(np.argmin(gaps))
        best = min(best, gaps[k])
        low, high = s[max(k - 1, 0)], s[min(k + 1, 40)]
    return best


@given(seed=st.integers(0, 2**31), thin=st.sampled_from([1.0, 1e-4]), length=st.sampled_from([0.0, 0.1, 5.0]))
@settings(deadline=None, max_examples=40)
def test_separation_of_a_segment_and_a_triangle(seed, thin, length):
    rng = np.random.default_rng(seed)
    triangle = rng.normal(size=(3, 3))
    triangle[2] = triangle[0] + 0.3 * (triangle[1] - triangle[0]) + thin * triangle[2]
    start = rng.normal(size=3)
    ends = np.array([start, start + length * rng.normal(size=3)])
    found = np.sqrt(_kernels.separation_of(triangle.reshape(1, 9), ends.ravel()))
    # The distance to a triangle along a segment is convex, so that the closer looks above do not miss it.
    assert found == pytest.approx(segment_distance(triangle, ends), abs=2e-5)


@given(seed=st.integers(0, 2**31), keep=st.floats(0.05, 1.0), turn=st.sampled_from([0.0, 0.3]))
@settings(deadline=None, max_examples=12)
def test_impact_of_a_capsule(seed, keep, turn):
    rng = np.random.default_rng(seed)
    triangle = rng.normal(size=(3, 3))
    start = 2 * rng.normal(size=3)
    ends = np.r_[start, start + 2 * rng.normal(size=3)]
    motion = rng.normal(size=3)
    moves = np.r_[motion, motion + turn * rng.normal(size=3)]

    def distance(t):
        return segment_distance(triangle, (ends + t * moves).reshape(2, 3))

    if distance(0.0) < keep + 1e-4:
        return
    plane = np.empty(4)
    when = _kernels.impact_of(triangle.reshape(1, 9), keep, np.r_[ends, moves], np.zeros(2), plane)
    passed = np.array([distance(t) for t in np.linspace(0, min(when, 1.0), 12)])
    assert (passed > keep - 1e-9).all()
    if when < np.inf:
        assert distance(when) == pytest.approx(keep, abs=1e-3 if turn else 1e-5)
        assert (triangle @ plane[:3] <= plane[3] + 1e-12).all()
        # Between the two at the start too: standing still satisfies what is asked of both ends.
        assert (ends.reshape(2, 3) @ plane[:3] - plane[3] >= keep - 1e-6).all()


@pytest.mark.parametrize("name", ["rough", "flipped", "wall", "fan"])
def test_a_sphere_as_a_capsule_moves_as_the_sphere(name):
    fixture = MeshFixture(HARD[name])
    tool = SphereTool(0.7)
    control, general = Controller([fixture], tool), BodySteps([fixture], tool, 0.5, 0.25)
    rng = np.random.default_rng(3)
    compared = 0
    while compared < 400:
        x = fixture.mesh.vertices[rng.integers(len(fixture.mesh.vertices))] + rng.normal(size=3)
        for _ in range(10):
            desired = 0.1 * rng.normal(size=3)
            desired *= min(1, 0.25 / np.linalg.norm(desired))
            step = control.step(x, desired)
            motion, status, clearance, *_ = general.step(x, np.array(desired))
            assert (status >= 2) == step.stopped
            np.testing.assert_allclose(motion, step.motion, atol=1e-5)
            if not step.stopped:
                assert clearance == pytest.approx(step.clearance, abs=2e-5)
            compared += 1
            x = x + step.motion


def farthest_in(other, tool, pose):
    """Least of distance less radius along a tool's segments, by another library."""
    turn = Rotation.from_rotvec(pose[3:])
    least = np.inf
    for body in tool.bodies:
        count = 2 + int(np.linalg.norm(body[3:6] - body[:3]) / 0.3)
        for point in np.linspace(body[:3], body[3:6], count):
            least = min(least, other(pose[:3] + turn.apply(point)) - body[6])
    return least


def outside(fixture, control, rng):
    while True:
        x = fixture.mesh.vertices[rng.integers(len(fixture.mesh.vertices))] + rng.normal(size=3)
        pose = np.r_[x, Rotation.random(random_state=rng).as_rotvec()]
        if not control.step(pose, np.zeros(6)).stopped:
            return pose


@pytest.mark.parametrize("name", ["plate", "spikes", "rough"])
def test_a_tool_with_a_shaft_is_never_in(name):
    fixture, other = MeshFixture(HARD[name]), VtkDistance(HARD[name])
    tool = ShaftTool(0.6, 0.4, 15.0)
    control = Controller([fixture], tool)
    rng = np.random.default_rng(4)
    met, least, wanted = 0, np.inf, np.inf
    for k in range(300):
        if k % 60 == 0:
            pose = outside(fixture, control, rng)
        if k % 15 == 0:
            lever = rng.uniform(0, 15) * Rotation.from_rotvec(pose[3:]).apply([0, 0, 1])
            towards = fixture.index.nearest((pose[:3] + lever)[None]).points[0] - pose[:3] - lever
            push = 0.1 * towards / np.linalg.norm(towards) + 0.03 * rng.normal(size=3)
            turn = np.cross(lever, push) / (10 + lever @ lever) * rng.choice([0.3, 3])
        step = control.step(pose, np.r_[push, turn])
        assert step.status in ("free", "constrained")
        if step.status == "constrained":
            met += 1
            for part in (0.5, 1.0):
                least = min(least, farthest_in(other, tool, moved(pose, part * step.motion)))
            wanted = min(wanted, farthest_in(other, tool, moved(pose, np.r_[push, turn])))
        pose = moved(pose, step.motion)
    assert met > 100
    assert least > 0
    assert wanted < -0.05  # the control


def test_pressing_and_turning_for_long_does_not_creep():
    fixture, other = MeshFixture(plate(4, 80.0)), VtkDistance(plate(4, 80.0))
    tool = ShaftTool(1.0, 1.0, 20.0)
    control = Controller([fixture], tool)
    pose = np.array([0.0, 0, 1.5, 0, 1.5, 0])  # nearly lying on the plate
    for k in range(3000):
        step = control.step(pose, [0, 0, -0.1, 0.01 * np.sin(k / 50), 0.01, 0.01 * np.cos(k / 70)])
        pose = moved(pose, step.motion)
        assert not step.stopped
    assert 0 < farthest_in(other, tool, pose) < 1e-3


def test_in_a_slot_as_wide_as_the_tool_it_still_slides():
    sheets = [np.array([[-90.0, -90, z], [90, -90, z], [0, 180, z]]) for z in (-1.0, 1.0)]
    control = Controller(
        [MeshFixture((np.concatenate(sheets), np.arange(6).reshape(2, 3)))], ShaftTool(0.9, 1 - 1e-8, 9.0)
    )
    pose = np.array([0.0, 0, 0, 0, np.pi / 2, 0])
    for _ in range(20):
        step = control.step(pose, [0.1, 0, -0.1, 0.005, 0.005, 0])
        assert step.status == "constrained"
        assert step.motion[0] == pytest.approx(0.1, abs=1e-6)
        pose = moved(pose, step.motion)


def test_free_steps_are_as_desired():
    control = Controller([MeshFixture(plate(6))], ShaftTool.from_drill(Drill()))
    desired = np.array([0.1, -0.05, 0.02, 1e-3, -2e-3, 3e-3])
    step = control.step([0, 0, 30, 0, 0, 0], desired)
    assert step.status == "free"
    np.testing.assert_allclose(step.motion, desired, atol=1e-15)
    step = control.step([0, 0, 30, 0, 0, 0], [3.0, 0, 0, 0, 0.3, 0])
    assert step.clipped
    np.testing.assert_allclose(step.motion, [0.25, 0, 0, 0, 0.02, 0], atol=1e-15)


def test_spheres_88_hundredths_apart_cover_what_is_said_of_them():
    """Section 3.6: at that spacing the gap between spheres of the shaft's radius is a tenth of it deep."""
    tool = ShaftTool(1.0, 1.0, 30.0, spheres=True)
    centres, radii = tool.bodies[1:, 2], tool.bodies[1:, 6]
    assert radii[0] == pytest.approx(1.1136, abs=1e-4)
    along = np.linspace(0, 30, 2000)
    covered = np.sqrt(np.maximum(radii**2 - (along[:, None] - centres) ** 2, 0)).max(axis=1).min()
    assert covered == pytest.approx(1.0, abs=5e-3)
    assert covered >= 1.0
    assert covered / radii[0] == pytest.approx(0.898, abs=5e-3)
    # Of the shaft's own radius and 0.88 of it apart, as the text has them:
    off = along[:, None] - np.arange(0, 31, 0.88)
    covered = np.sqrt(np.maximum(1 - off**2, 0)).max(axis=1)
    assert covered.min() == pytest.approx(0.898, abs=1e-3)


@pytest.mark.parametrize("spheres", [False, True])
def test_capsules_and_spheres_are_kept_out_alike(spheres):
    ball = rough(subdivisions=3)
    fixture, other = MeshFixture(ball), VtkDistance(ball)
    tool = ShaftTool(0.6, 0.5, 10.0, spheres=spheres)
    control = Controller([fixture], tool)
    pose = np.array([0.0, -3, 9, 0, np.pi / 2, 0])
    for _ in range(120):
        step = control.step(pose, [0, 0, -0.1, 0, 0, 0])
        pose = moved(pose, step.motion)
    assert step.status == "constrained"
    assert farthest_in(other, ShaftTool(0.6, 0.5, 10.0), pose) > 0


def pressed(control, steps, push, x=(0.0, 0, 1.3)):
    x, deepest = np.array(x), 0.0
    for _ in range(steps):
        step = control.step(x, push)
        x = x + step.motion
        deepest = max(deepest, step.depths.max())
        assert np.linalg.norm(step.motion) <= 0.25 + 1e-12
    return x, step, deepest


@pytest.mark.parametrize("count", [4, 40, 120])
@pytest.mark.parametrize(("push", "weight", "depth"), [(0.02, 0.1, 0.2), (0.05, 0.5, 0.1), (0.2, 0.1, 0.5)])
def test_slack_is_as_deep_as_pressing_is_hard_whatever_the_mesh(count, push, weight, depth):
    control = Controller([MeshFixture(plate(count), slack=Slack(0.5, weight))], SphereTool(1.0))
    x, step, deepest = pressed(control, 150, [0, 0, -push])
    assert step.depths[0] == pytest.approx(depth, abs=1e-4)
    assert x[2] == pytest.approx(1 - depth, abs=1e-4)
    assert deepest <= 0.5
    # let go
    x, step, _ = pressed(control, 200, [0, 0, 0], x)
    assert x[2] == pytest.approx(1, abs=1e-3)


def test_slack_does_not_creep():
    control = Controller([MeshFixture(rough(), slack=Slack(0.3, 0.01))], SphereTool(0.8))
    other = VtkDistance(rough())
    rng = np.random.default_rng(0)
    x = np.array([0.0, 0, 8])
    for k in range(3000):
        push = -0.1 * x / np.linalg.norm(x) + 0.03 * rng.normal(size=3)
        step = control.step(x, push)
        x = x + step.motion
        if k % 5 == 0:
            gap = other(x)
            assert gap > 0.5
            assert step.depths[0] == pytest.approx(max(0.8 - gap, 0), abs=1e-5)
    assert step.depths[0] > 0.2


def test_bone_may_be_cut_and_the_nerve_not():
    bone = plate(10, 40.0)
    nerve = bone[0][:, [2, 0, 1]] + [2.0, 0, 0], bone[1]  # a wall at x = 2
    control = Controller(
        [MeshFixture(bone, "bone", slack=Slack(0.4, 0.05)), MeshFixture(nerve, "nerve")], SphereTool(1.0)
    )
    x, step, _ = pressed(control, 200, [0.1, 0, -0.1], (-1.0, 0, 1.2))
    assert step.depths == pytest.approx([0.4, 0], abs=1e-5)
    assert x[0] == pytest.approx(1.0, abs=1e-5)
    assert x[0] < 1.0


def test_only_the_tip_has_slack():
    control = Controller([MeshFixture(plate(10, 40.0), slack=Slack(0.5, 0.01))], ShaftTool(1.0, 1.0, 10.0))
    lying = np.array([0.0, 0, 1.3, 0, np.pi / 2, 0])
    for _ in range(60):
        step = control.step(lying, [0, 0, -0.1, 0, 0, 0])
        lying = moved(lying, step.motion)
    shaft = lying[2] + 10 * Rotation.from_rotvec(lying[3:]).apply([0, 0, 1])[2]
    # The shaft stays on the plate, or the tip would be in to 0.5 mm.
    assert min(lying[2], shaft) > 1 - 1e-4


def test_too_much_slack_is_refused():
    with pytest.raises(InputError, match=r"below the tip's radius and clearance, 1\.2 mm, got 1\.5"):
        Controller([MeshFixture(plate(4), clearance_mm=0.2, slack=Slack(1.5))], SphereTool(1.0))
    for depth, weight in ((0.0, 1.0), (-1.0, 1.0), (np.nan, 1.0), (1.0, 0.0), (1.0, np.inf)):
        with pytest.raises(InputError, match="above 0"):
            Slack(depth, weight)


@given(seed=st.integers(0, 2**31), joints=st.integers(3, 7), turning=st.booleans())
@settings(deadline=None, max_examples=25)
def test_through_joints_as_another_solver(seed, joints, turning):
    """Far from everything: the damped least squares between bounds."""
    rng = np.random.default_rng(seed)
    tool = ShaftTool(1.0, 0.5, 20.0) if turning else SphereTool(1.0)
    control = Controller([MeshFixture(plate(4))], tool)
    m = tool.freedoms
    J = rng.normal(size=(m, joints)) * (np.array([50.0] * 3 + [1.0] * 3)[:m, None])
    upper, lower = rng.uniform(0, 3e-3, joints), -rng.uniform(0, 3e-3, joints)
    desired = np.array([0.05] * 3 + [1e-3] * 3)[:m] * rng.normal(size=m)
    pose = np.r_[0, 0, 90, np.zeros(m - 3)]
    joint = control.step_joints(pose, desired, J, lower, upper, damping=2.0)
    W = np.array([1.0] * 3 + [tool.lever] * 3)[:m] if turning else np.ones(m)
    H = (W[:, None] * J).T @ (W[:, None] * J) + 4 * np.eye(joints)
    import quadprog

    G = np.vstack([np.eye(joints), -np.eye(joints)])
    wanted = desired.copy()
    wanted[:3] *= min(1, 0.25 / np.linalg.norm(wanted[:3]))
    turns = quadprog.solve_qp(H, J.T @ (W**2 * wanted), G.T, np.r_[lower, -upper])[0]
    np.testing.assert_allclose(joint.turns, turns, atol=1e-9)
    np.testing.assert_allclose(joint.step.motion, J @ joint.turns, atol=1e-9)
    assert (joint.turns >= lower).all()
    assert (joint.turns <= upper).all()


def test_through_joints_never_in():
    fixture, other = MeshFixture(rough()), VtkDistance(rough())
    control = Controller([fixture], SphereTool(0.8))
    rng = np.random.default_rng(5)
    x, met = np.array([0.0, 0, 9]), 0
    for _ in range(500):
        J = 20 * rng.normal(size=(3, 6)) @ np.diag(rng.choice([1, 1, 1e-6], 6))  # often singular
        joint = control.step_joints(
            x, -0.1 * x / np.linalg.norm(x), J, np.full(6, -0.01), np.full(6, 0.01), 0.5
        )
        assert not joint.step.stopped
        met += joint.step.status == "constrained" and joint.step.planes > 0
        x = x + J @ joint.turns
        assert other(x) > 0.8
    assert met > 300


def test_bad_joints_are_refused():
    control = Controller([MeshFixture(plate(4))], SphereTool(1.0))
    good = {"jacobian": np.eye(3), "lower": -np.ones(3), "upper": np.ones(3)}
    control.step_joints([0, 0, 9], [0, 0, 0.1], **good)
    for name, value, message in (
        ("jacobian", np.eye(4), r"expected \(3, n\)"),
        ("lower", np.full(3, 0.1), "lower <= 0 <= upper"),
        ("upper", np.full(3, np.nan), "lower <= 0 <= upper"),
        ("jacobian", np.full((3, 3), np.inf), "finite Jacobian"),
        ("jacobian", np.zeros((3, 3)), "damping"),
    ):
        with pytest.raises(InputError, match=message):
            control.step_joints([0, 0, 9], [0, 0, 0.1], **{**good, name: value})
    with pytest.raises(InputError, match="damping"):
        control.step_joints([0, 0, 9], [0, 0, 0.1], **good, damping=-1.0)


def test_as_it_reads():
    """Joints, a plane: the same programme written out with the plane's row, by another solver."""
    control = Controller([MeshFixture(plate(4, 60.0))], SphereTool(1.0))
    rng = np.random.default_rng(6)
    for _ in range(50):
        J = 30 * rng.normal(size=(3, 3))
        x = np.array([0, 0, 1.0 + rng.uniform(0, 0.05)])
        desired = np.r_[rng.uniform(-0.15, 0.15, 2), -0.1]
        joint = control.step_joints(x, desired, J, np.full(3, -1.0), np.full(3, 1.0))
        plain = nearest_motion([[0, 0, 1.0]], [1 + 1e-6 - x[2]], desired, "nnls")
        np.testing.assert_allclose(joint.step.motion, plain, atol=1e-6)


def test_bad_tools_are_refused():
    for arguments in ({"radius": -1.0}, {"radius": 1.0, "shaft_radius": 0.0}, {"radius": 1.0, "length": 0.0}):
        with pytest.raises(InputError, match="expected"):
            ShaftTool(**arguments)
    for cylinder in ((0.0, 0.0, 5.0), (1.0, 5.0, 5.0), (1.0, 0.0, np.nan)):
        with pytest.raises(InputError, match="expected"):
            ShaftTool(1.0, cylinders=(cylinder,))
    with pytest.raises(InputError, match="six coordinates"):
        Controller([MeshFixture(plate(4))], ShaftTool(1.0)).step([0, 0, 9], [0, 0, 0])
    with pytest.raises(InputError, match="3 or 6"):
        moved(np.zeros(4), np.zeros(4))
