from functools import cache

import numpy as np
import pytest
import quadprog
from arm_fixture_cases import T_EE_TOOL, UR5, CoalDistance, holding, tool_at
from fixture_cases import HARD, VtkDistance, plate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError, ReachError
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, SphereTool, moved
from study.fixtures.arm import ArmController, Damping
from study.fixtures.arm.held import HeldTool
from study.robots.arms import arm
from study.transforms import inverse, rigid

SPHERE, SHAFT = SphereTool(1.0), ShaftTool(1.0, 0.6, 30.0)
both = pytest.mark.parametrize("tool", [SPHERE, SHAFT], ids=["sphere", "shaft"])
PLATE = plate()
FAR = rigid(translation=[0, 0, 50.0])  # from the plate: nothing to keep away from
TOUCHES = rigid(translation=[0, 0, 1.0 + 0.01 + 1e-5])  # the allowance of 0.01 mm on top of the radius


@cache
def mesh_distance(name, tool):
    return CoalDistance(HARD[name], tool)


def planned(T, motion):
    """T_mesh_tool after a motion."""
    turn = Rotation.from_rotvec(motion[3:] if len(motion) == 6 else np.zeros(3))
    return rigid(turn.as_matrix() @ T[:3, :3], T[:3, 3] + motion[:3])


def apart(T, U, tool):
    """How far tip and far end, of a tool that turns, are from one another at two poses, mm."""
    ends = [0.0, 30.0] if tool.freedoms == 6 else [0.0]
    return max(np.linalg.norm((T - U)[:3, 3] + z * (T - U)[:3, 2]) for z in ends)


def finite_jacobian(hold, q, freedoms):
    h = 1e-6
    columns = []
    for step in h * np.eye(6):
        after, before = tool_at(hold, q + step), tool_at(hold, q - step)
        turn = Rotation.from_matrix(after[:3, :3] @ before[:3, :3].T).as_rotvec()
        columns.append(np.r_[after[:3, 3] - before[:3, 3], turn][:freedoms] / (2 * h))
    return np.transpose(columns)


def desired_of(rng, tool, along=0.2, turn=0.01):
    wanted = rng.normal(size=6) * np.repeat([along, turn], 3) / np.sqrt(3)
    return wanted[: tool.freedoms]


@both
def test_pose_is_the_product_of_transforms(tool):
    hold, _ = holding(PLATE, tool, FAR)
    rng = np.random.default_rng(1)
    for q in rng.uniform(-3, 3, (30, 6)):
        T, pose = tool_at(hold, q), hold.pose(q)
        assert pose.shape == (tool.freedoms,)
        np.testing.assert_allclose(pose[:3], T[:3, 3], atol=1e-10)
        if tool.freedoms == 6:
            np.testing.assert_allclose(Rotation.from_rotvec(pose[3:]).as_matrix(), T[:3, :3], atol=1e-13)


@both
def test_far_from_surfaces_it_is_the_quadratic_programme(tool):
    rng = np.random.default_rng(2)
    hold, _ = holding(PLATE, tool, rigid(translation=[0, 0, 3000.0]))
    weights = np.repeat([1 / getattr(tool, "lever", 30.0), 1.0], 3)[: tool.freedoms]
    bounded = plain = 0
    for k in range(60):
        q = rng.uniform(-3, 3, 6)
        if k % 2:  # a joint that is nearly at its limit
            q[2] = UR5.limits[2, 1] - 1e-4
        wanted = desired_of(rng, tool, 0.1, 0.005)
        step = hold.step(q, wanted)
        assert not step.step.clipped
        if step.rounds > 1 or step.part < 1:  # too curved for that much even here
            continue
        J = weights[:, None] * finite_jacobian(hold, q, tool.freedoms)
        assert step.singular_value == pytest.approx(np.linalg.svd(J, compute_uv=False)[-1], abs=1e-6)
        H = J.T @ J + step.damping**2 * np.eye(6)
        most = UR5.speeds * hold.cycle_s
        lower, upper = np.maximum(-most, UR5.limits[:, 0] - q), np.minimum(most, UR5.limits[:, 1] - q)
        best = quadprog.solve_qp(
            H, J.T @ (weights * wanted), np.c_[np.eye(6), -np.eye(6)], np.r_[lower, -upper]
        )[0]

        def cost(dq, J=J, wanted=wanted, damping=step.damping):
            return ((J @ dq - weights * wanted) ** 2).sum() + damping**2 * (dq @ dq)

        # the finite differences leave 1e-8 of a Jacobian, which little damping makes visible
        assert cost(step.turns) <= cost(best) + 1e-9
        np.testing.assert_allclose(step.turns, best, atol=1e-5)
        at = np.isclose(best, lower, atol=1e-12) | np.isclose(best, upper, atol=1e-12)
        assert np.array_equal(step.limited, at)
        bounded += at.any()
        plain += not at.any()
    assert bounded >= 5 and plain >= 5


@both
@pytest.mark.parametrize("name", ["rough", "wall", "spikes", "fan"])
def test_the_tool_never_enters(tool, name):
    """Distances by coal of the arm's exact poses, on the way of each step too; unguided it enters."""
    distance = mesh_distance(name, tool)
    rng = np.random.default_rng(3)
    for start in ([0, 0, 8.0], [5.0, -3.0, 7.0]):
        hold, q = holding(HARD[name], tool, rigid(translation=start), clearance=0.02)
        free = q.copy()
        least = unguided = np.inf
        wanted = np.zeros(tool.freedoms)
        met = 0
        for _ in range(150):
            here = tool_at(hold, q)
            # into the middle, and about
            toward = -here[:3, 3] / np.linalg.norm(here[:3, 3])
            wanted = 0.7 * wanted + 0.5 * desired_of(rng, tool)
            wanted[:3] += 0.12 * toward
            step = hold.step(q, wanted)
            assert not step.stopped
            for part in (0.25, 0.5, 0.75, 1.0):
                least = min(least, distance(tool_at(hold, q + part * step.turns)))
            q = q + step.turns
            met += step.step.planes > 0
            free = free + np.linalg.pinv(hold.held.place(free).jacobian) @ wanted
            unguided = min(unguided, distance(tool_at(hold, free)))
        assert least >= 0.02
        assert met > 30
        assert unguided < -0.05


@both
@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10**6))
def test_limits_speeds_and_what_is_told_of_a_step_hold_everywhere(tool, seed):
    """Walks that begin near singularities and at limits, or past one, with a hand that asks for too much."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-3, 3, 6)
    q[[2, 4]] = rng.choice([0.0, 1e-3, 1.5], 2)  # stretched; axes 4 and 6 parallel
    at, end = rng.integers(6), rng.integers(2)
    q[at] = UR5.limits[at, end] + (2 * end - 1) * rng.choice([0.0, 1e-4, 0.1])
    hold, q = holding(PLATE, tool, TOUCHES, q)
    clear = CoalDistance(PLATE, tool)
    most = UR5.speeds * hold.cycle_s
    wanted = desired_of(rng, tool, 0.5, 0.05)
    for _ in range(12):
        wanted = wanted + desired_of(rng, tool, 0.1, 0.01)
        step = hold.step(q, wanted)
        low, high = UR5.limits.T
        assert np.array_equal(step.beyond, (q < low) | (q > high))
        assert (np.abs(step.turns) <= most).all()
        there = q + step.turns
        assert (there <= np.maximum(high, q)).all() and (there >= np.minimum(low, q)).all()
        T, U = tool_at(hold, q), tool_at(hold, there)
        off = apart(U, planned(T, step.step.motion), tool)
        assert off == pytest.approx(step.deviation_mm, abs=1e-10)
        for part in np.linspace(0.1, 1.0, 10):
            on_way = tool_at(hold, q + part * step.turns)
            assert apart(on_way, planned(T, part * step.step.motion), tool) <= step.bow_mm + 1e-10
            if not step.stopped:
                assert clear(on_way) >= 0.0
        q = there


def test_at_a_singularity_damping_keeps_turns_small():
    """Stretched arm, axes 4 and 6 nearly parallel, and a motion that neither can make."""
    q = UR5.ready.copy()
    q[4] = 1e-4
    hold, _ = holding(PLATE, SHAFT, FAR, q)
    weak, _ = holding(PLATE, SHAFT, FAR, q, damping=Damping(most=0.0), cycle_s=0.1)
    J = hold.held.weighted(hold.held.place(q))
    wanted = np.linalg.svd(J)[0][:, -1] * 0.005 * np.repeat([SHAFT.lever, 1.0], 3)
    damped, plain = hold.step(q, wanted), weak.step(q, wanted)
    assert damped.singular_value < 0.001
    assert damped.damping == pytest.approx(np.hypot(0.3, 0.003), rel=1e-3) and plain.damping == 0.003
    assert np.abs(plain.turns).max() > 5 * np.abs(damped.turns).max()
    assert np.abs(damped.turns).max() <= 0.005 / (2 * 0.3)
    # nothing is known of what is farther than clearance is measured
    fast = weak.step(q, 4 * wanted)
    assert fast.step.clearance == np.inf and fast.part < 1.0
    assert fast.bow_mm <= weak.control.far_mm + 0.01


def test_damping_law():
    law = Damping(below=10.0, most=8.0, least=0.5)
    assert law.at(10.0) == law.at(50.0) == 0.5
    assert law.at(0.0) == pytest.approx(np.hypot(8.0, 0.5))
    assert law.at(5.0) == pytest.approx(np.sqrt(0.75 * 64 + 0.25))
    assert law.at(9.999) == pytest.approx(0.5, abs=0.02)
    same = Damping()
    for s in np.linspace(0, 1, 100):  # what a motion of length 1 asks for in the worst direction
        assert s / (s**2 + same.at(s) ** 2) <= 1.02 / same.below


@both
def test_it_slides_along_a_plate(tool):
    hold, q = holding(PLATE, tool, TOUCHES @ rigid(translation=[-3, -2, 0]))
    start = tool_at(hold, q)
    clear = CoalDistance(PLATE, tool)
    wanted = np.zeros(tool.freedoms)
    wanted[:3] = 0.05, 0.03, -0.04
    for _ in range(100):
        step = hold.step(q, wanted)
        assert step.step.status == "constrained" and step.part == 1.0
        q = q + step.turns
        assert 0.009 < clear(tool_at(hold, q)) < 0.011  # as near as is allowed, and no nearer
    made = tool_at(hold, q)[:3, 3] - start[:3, 3]
    assert np.hypot(*made[:2]) >= 0.98 * 100 * np.hypot(0.05, 0.03)


def test_long_contact_does_not_creep():
    """What steps end off by does not add up: a thousand of them stay as far as is to be kept, and as near."""
    hold, q = holding(PLATE, SPHERE, TOUCHES)
    heights = []
    for k in range(1000):
        angle = 0.02 * k
        step = hold.step(q, [0.04 * np.cos(angle), 0.04 * np.sin(angle), -0.05])
        assert step.step.status == "constrained"
        q = q + step.turns
        heights.append(tool_at(hold, q)[2, 3])
    assert min(heights) >= 1.01 and max(heights) < 1.01 + 1e-4


@both
def test_a_tool_that_starts_inside_is_reported_and_not_moved(tool):
    hold, q = holding(PLATE, tool, rigid(translation=[0, 0, 0.9]))
    step = hold.step(q, np.r_[0.1, 0, 0.1, np.zeros(tool.freedoms - 3)])
    assert step.step.status == "inside" and step.stopped
    assert not step.turns.any() and not step.step.motion.any() and not step.limited.any()
    assert step.step.clearance == pytest.approx(-0.11, abs=1e-3)


def test_a_motion_that_is_too_curved_is_shortened_where_that_matters():
    """The same turn of 20 mrad far away, and at the plate with next to no allowance."""
    wanted = np.array([0, 0, 0, 0.01, 0.0, 0.0173])
    far, q = holding(PLATE, SHAFT, FAR)
    assert far.step(q, wanted).part == 1.0
    above = rigid(translation=[0, 0, 1.02])
    near, q = holding(PLATE, SHAFT, above, allowance_mm=3e-4)
    step = near.step(q, wanted)
    assert 0.0 < step.part < 1.0 and not step.stopped
    assert 1e-4 < step.bow_mm <= 2e-4 + max(0, step.step.clearance)  # no shorter than need be
    assert step.rounds <= 3
    assert np.linalg.norm(step.step.motion[3:]) <= 1.01 * step.part * 0.02


def test_too_long_a_motion_is_cut_and_told():
    hold, q = holding(PLATE, SHAFT, FAR)
    step = hold.step(q, [3.0, 0, 4.0, 0, 0, 1.0])
    assert step.step.clipped
    assert np.linalg.norm(step.step.motion[:3]) <= 0.25 * 1.001
    assert np.linalg.norm(step.step.motion[3:]) <= 0.02 * 1.001
    assert not hold.step(q, [0.03, 0, 0.04, 0, 0, 0.01]).step.clipped


def test_slack_is_as_deep_as_it_may_be_and_no_deeper():
    slack = Slack(0.3)
    hold, q = holding(PLATE, SPHERE, TOUCHES, slack=slack)
    depths = []
    for _ in range(60):
        step = hold.step(q, [0.0, 0.02, -0.2])
        assert not step.stopped
        q = q + step.turns
        depths.append(1.01 - tool_at(hold, q)[2, 3])
        assert step.step.depths[0] == pytest.approx(max(0.0, depths[-1]), abs=1e-4)
    assert 0.2 < max(depths) <= 0.3 + 1e-6
    for _ in range(60):
        q = q + hold.step(q, [0.0, 0.0, 0.0]).turns
    assert 1.01 - tool_at(hold, q)[2, 3] < 0.02  # let go, it is led out


def test_slack_is_let_go_slowly_where_the_way_is_curved():
    deepest = rigid(translation=[0, 0, 1.0 + 1.05e-4 - 0.9 + 2e-6])
    hold, q = holding(PLATE, SPHERE, deepest, slack=Slack(0.9, 10.0), allowance_mm=1.05e-4)
    step = hold.step(q, [0.0, 0.0, 0.0])
    assert not step.stopped and 0.0 < step.part < 1.0
    assert 0.01 < step.step.motion[2] < 0.2
    assert step.bow_mm <= 5e-6 + 2e-6


def test_a_slot_that_is_too_narrow_for_the_whole_turn_leaves_a_part_of_it():
    vertices, faces = PLATE
    room = 2 * (1.0 + 0.01) + 1.5e-3
    above = vertices + np.array([0, 0, room])
    slot = np.r_[vertices, above], np.r_[faces, faces + len(vertices)]
    rod = ShaftTool(1.0, 1.0, 5.0)
    # the rod lies along x, half-way between two plates
    lying = rigid(Rotation.from_euler("y", 90, degrees=True), [-2.0, 0, 0.5 * room])
    hold, q = holding(slot, rod, lying)
    wanted = [0, 0, 0, 0.0, 0.0, 0.02]
    step = hold.step(q, wanted)
    J = hold.held.place(q).jacobian
    whole = hold.control.step_joints(hold.pose(q), wanted, J, *hold.bounds(q), step.damping * 2.5).step
    assert whole.status in ("infeasible", "unsettled")
    assert step.step.status == "constrained" and 0.0 < step.part < 1.0
    assert step.step.motion[5] > 1e-3


def test_the_curvature_bounds_second_derivatives():
    """Joint 6 alone, the tip on its axis and the shaft at a right angle: the far end alone is carried."""
    across = rigid(Rotation.from_euler("x", 90, degrees=True), [0, 0, 80.0])
    held = HeldTool(UR5, SHAFT, np.eye(4), across)
    rng = np.random.default_rng(7)
    turns = [np.eye(6)[5], *rng.normal(size=(30, 6))]
    for unit in turns:
        q, dq = rng.uniform(-3, 3, 6), 1e-3 * unit
        ends = []
        for part in (-0.5, 0.0, 0.5):
            T = UR5.forward(q + part * dq) @ across
            ends.append([T[:3, 3], T[:3, 3] + 30.0 * T[:3, 2]])
        seconds = np.linalg.norm(4 * (ends[0] - 2 * np.array(ends[1]) + ends[2]), axis=1)
        bound = held.curvature(held.place(q), dq, 0.0)
        assert seconds.max() <= bound * (1 + 1e-5)
        assert seconds.max() > 0.01 * bound


def test_an_industrial_arm_serves_as_well():
    kr3 = arm("KR3")
    hold, q = holding(PLATE, SHAFT, TOUCHES, arm=kr3)
    assert hold.cycle_s == kr3.cycle_s
    clear = CoalDistance(PLATE, SHAFT)
    for _ in range(30):
        step = hold.step(q, [0.05, 0, -0.05, 0.001, 0, 0])
        q = q + step.turns
        assert clear(tool_at(hold, q)) >= 0
    assert tool_at(hold, q)[0, 3] > 1.0


def test_joints_bring_the_tool_to_a_pose():
    hold, q = holding(PLATE, SHAFT, FAR)
    T = planned(tool_at(hold, q), np.array([20.0, -30, 10, 0.1, 0.2, -0.1]))
    np.testing.assert_allclose(tool_at(hold, hold.joints(T, q)), T, atol=1e-8)
    with pytest.raises(ReachError, match="UR5"):
        hold.joints(planned(T, np.array([5000.0, 0, 0, 0, 0, 0])))
    with pytest.raises(InputError, match="T_mesh_tool"):
        hold.joints(2 * np.eye(4))


def test_the_distance_it_keeps_agrees_with_vtk():
    hold, q = holding(HARD["rough"], SPHERE, rigid(translation=[0, 0, 8.0]))
    for _ in range(40):
        q = q + hold.step(q, [0.02, 0.01, -0.2]).turns
    T = tool_at(hold, q)
    far = VtkDistance(HARD["rough"])(T[:3, 3]) - 1.0
    assert far == pytest.approx(mesh_distance("rough", SPHERE)(T), abs=1e-12)
    assert 0.0 <= far < 0.02


def test_bad_input_is_named():
    hold, q = holding(PLATE, SHAFT, FAR)
    control = Controller([MeshFixture(PLATE)], SHAFT)

    def made(**changes):
        given = {"T_mesh_rob": np.eye(4), "T_ee_tool": T_EE_TOOL} | changes
        return ArmController(UR5, given.pop("control", control), **given)

    with pytest.raises(InputError, match="T_mesh_rob"):
        made(T_mesh_rob=2 * np.eye(4))
    with pytest.raises(InputError, match="T_ee_tool"):
        made(T_ee_tool=np.eye(3))
    for cycle in (0.0, np.nan, -1.0):
        with pytest.raises(InputError, match="cycle_s: expected a time above 0 s"):
            made(cycle_s=cycle)
    for allowance in (0.0, 1e-4, np.inf):
        with pytest.raises(InputError, match=r"allowance_mm: expected a length above 0\.0001 mm"):
            made(allowance_mm=allowance)
    with pytest.raises(InputError, match="expected the method 'exact', got 'published'"):
        made(control=Controller([MeshFixture(PLATE)], SPHERE, method="published"))
    with pytest.raises(InputError, match="joint angles: expected six finite numbers"):
        hold.step(np.full(6, np.nan), np.zeros(6))
    with pytest.raises(InputError, match="joint angles"):
        hold.bounds(np.zeros(5))
    with pytest.raises(InputError, match="pose, desired"):
        hold.step(q, np.zeros(3))
    with pytest.raises(InputError, match="finite"):
        hold.step(q, np.full(6, np.inf))
    for bad in ({"below": 0.0}, {"least": 0.0}, {"most": -1.0}, {"most": np.nan}):
        with pytest.raises(InputError, match=f"{next(iter(bad))}: expected a number above 0"):
            Damping(**bad)


def test_poses_are_those_of_the_controller():
    hold, q = holding(PLATE, SHAFT, FAR)
    step = hold.step(q, [0.1, 0.05, -0.1, 0.01, 0.0, -0.01])
    pose = moved(hold.pose(q), step.step.motion)
    T, U = tool_at(hold, q + step.turns), rigid(Rotation.from_rotvec(pose[3:]), pose[:3])
    assert apart(T, U, SHAFT) == pytest.approx(step.deviation_mm, abs=1e-9)
    np.testing.assert_allclose(inverse(U) @ T, np.eye(4), atol=0.01)


@both
def test_a_tool_that_is_inside_is_led_out_on_command(tool):
    hold, q = holding(PLATE, tool, rigid(translation=[0, 0, 0.5]))
    assert hold.step(q, np.zeros(tool.freedoms)).step.status == "inside"
    deepest = hold.control.step(hold.pose(q), np.zeros(tool.freedoms)).clearance
    for _ in range(10):
        step = hold.lead_out(q)
        if step.step.status == "free":
            break
        assert step.step.status == "led out" and step.part == 1.0
        assert (np.abs(step.turns) <= UR5.speeds * hold.cycle_s).all()
        T, U = tool_at(hold, q), tool_at(hold, q + step.turns)
        assert apart(U, planned(T, step.step.motion), tool) <= 1e-6
        q = q + step.turns
        assert step.step.clearance > deepest + 0.1 or step.step.clearance >= 0
        deepest = step.step.clearance
    assert step.step.status == "free" and not step.turns.any()
    assert CoalDistance(PLATE, tool)(tool_at(hold, q)) >= 0.01
    assert not hold.step(q, np.zeros(tool.freedoms)).stopped


def test_an_arm_that_cannot_follow_the_way_out_stays():
    """Slow joints make a part of the way; joints at their limits that bar it make none."""
    slow, q = holding(PLATE, SHAFT, rigid(translation=[0, 0, 0.5]), cycle_s=1e-4)
    step = slow.lead_out(q)
    assert step.step.status == "led out" and step.part < 1.0
    assert step.step.clearance == pytest.approx(-0.51 + step.step.motion[2], abs=1e-3)
    stuck, q = holding(PLATE, SHAFT, rigid(translation=[0, 0, 0.5]), cycle_s=1e-9)
    step = stuck.lead_out(q)
    assert step.step.status == "infeasible" and step.stopped
    assert not step.turns.any() and not step.step.motion.any() and step.part == 0.0
