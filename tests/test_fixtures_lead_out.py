"""A tool that is inside is led out on command: shortest way, never deeper, never pushed when outside."""

import numpy as np
import pytest
from fixture_cases import HARD, VtkDistance, ball, fan, flipped, plate, rough, together, wall
from hypothesis import given, settings
from hypothesis import strategies as st

from study.errors import InputError
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, SphereTool, moved
from study.fixtures.control.lead_out import LeadOut, covering_spheres

TOUCHING = 1e-4


def small(scale):
    vertices, faces = ball()
    return vertices * scale, faces


def led(control, pose, cycles=400):
    """Lead out until something else is answered: poses, steps made, the last answer."""
    poses, steps = [np.asarray(pose, dtype=np.float64)], []
    for _ in range(cycles):
        step = control.lead_out(poses[-1])
        if step.status != "led out":
            return poses, steps, step
        steps.append(step)
        poses.append(moved(poses[-1], step.motion))
    raise AssertionError("no end")


def lengths(steps):
    return np.array([np.linalg.norm(step.motion[:3]) for step in steps])


def depth_of(mesh, fixture, point, keep):
    """Of a centre, by VTK and parity."""
    distance = VtkDistance(mesh)(point)
    return keep + distance if fixture.closed and fixture.index.inside(point) else keep - distance


@pytest.mark.parametrize("start", [(0, 0, 3.0), (0.1, 0.2, 0.3), (0, 0, 5.2), (1.0, 2.0, -5.3)])
def test_out_of_a_ball(start):
    fixture = MeshFixture(ball())
    control = Controller([fixture], SphereTool(1.0))
    poses, steps, last = led(control, start)
    assert last.status == "free" and not last.motion.any()
    depths = [depth_of(ball(), fixture, x, 1.0) for x in poses]
    assert (np.diff(depths) < -1e-5).all()
    assert depths[-1] <= TOUCHING
    assert lengths(steps).max() <= 0.25 + 1e-12
    # No way out is shorter than the depth, and from nearly the middle no way is much longer.
    assert depths[0] - TOUCHING <= lengths(steps).sum() <= depths[0] * 1.01 + 1e-3
    assert control.step(poses[-1], -0.1 * poses[-1]).status in ("free", "constrained")
    assert [step.clearance for step in steps][-1] >= -TOUCHING
    assert all(step.clearance < 0 for step in steps[:-1])


def test_never_pushed_when_outside():
    for name, mesh in HARD.items():
        fixture = MeshFixture(mesh)
        control = Controller([fixture], SphereTool(0.5))
        rng, free = np.random.default_rng(4), 0
        for _ in range(40):
            x = mesh[0][rng.integers(len(mesh[0]))] + rng.normal(size=3)
            outside = control.step(x, np.zeros(3)).status != "inside"
            step = control.lead_out(x)
            assert (step.status == "free") == outside
            if outside:
                assert not step.motion.any()
                free += 1
        assert free > 3, name


@pytest.mark.parametrize("height", [0.05, 0.5, -0.4, -0.9])
def test_away_from_a_sheet_on_its_side(height):
    fixture = MeshFixture(plate())
    poses, steps, last = led(Controller([fixture], SphereTool(1.0)), (0.3, 0.2, height))
    assert last.status == "free"
    np.testing.assert_allclose(poses[-1], [0.3, 0.2, np.sign(height)], atol=2e-3)
    assert lengths(steps).sum() == pytest.approx(1 - abs(height), abs=2e-3)


def test_from_on_a_sheet_to_the_side_its_normals_face():
    poses, _, last = led(Controller([MeshFixture(plate())], SphereTool(1.0)), (0.3, 0.2, 0.0))
    assert last.status == "free" and poses[-1][2] > 0.99


def test_out_of_a_corner_though_straight_away_from_either_wall_does_not_help():
    one = plate(20, 12.0)
    other = (one[0][:, [2, 0, 1]], one[1])  # x = 0 and z = 0
    for fixtures in ([MeshFixture(one), MeshFixture(other)], [MeshFixture(together(one, other))]):
        poses, steps, last = led(Controller(fixtures, SphereTool(1.0)), (0.1, 0.1, 0.1))
        assert last.status == "free"
        assert min(abs(poses[-1][0]), abs(poses[-1][2])) > 1 - TOUCHING
        assert lengths(steps).sum() < 0.9 * np.sqrt(2) * 1.05


def test_nested_walls():
    """Of one surface with a cavity, out of the wall to whichever side is nearer."""
    mesh = together(ball(), small(0.4))
    fixture = MeshFixture(mesh)
    assert fixture.index.inside([0, 0, 3.0]) and not fixture.index.inside([0, 0, 1.0])
    control = Controller([fixture], SphereTool(0.3))
    for start, side in (((0, 0, 4.5), 1), ((0, 0, 2.4), -1)):
        poses, _, last = led(control, start)
        assert last.status == "free"
        assert side * (np.linalg.norm(poses[-1]) - 3.5) > 0
        assert np.all(np.diff([depth_of(mesh, fixture, x, 0.3) for x in poses]) < 0)


def test_nested_structures_never_deeper_into_either():
    outer, inner = MeshFixture(ball(), "bone"), MeshFixture(small(0.4), "nerve")
    control = Controller([outer, inner], SphereTool(0.5))
    for start in ((0, 0, 1.0), (0.2, 0, 2.2), (1.0, -1.0, 0.2)):
        poses, _, last = led(control, start)
        assert last.status == "free"
        for mesh, fixture in ((ball(), outer), (small(0.4), inner)):
            depths = np.maximum([depth_of(mesh, fixture, x, 0.5) for x in poses], 0)
            assert np.diff(depths).max() <= 1e-9


def test_a_gap_narrower_than_the_tool_is_a_stop():
    lower = plate(20, 12.0)
    mesh = together(lower, (lower[0] + [0, 0, 1.0], lower[1]))
    control = Controller([MeshFixture(mesh)], SphereTool(1.0))
    poses, _, last = led(control, (0.2, 0.1, 0.3))
    assert last.status == "infeasible" and last.stopped and not last.motion.any()
    assert 0 < poses[-1][2] < 1.0
    assert last.clearance == pytest.approx(-0.5, abs=0.05)


def test_two_structures_that_bar_each_other():
    """Out of one it would have to come deeper into the other."""
    box = wall(2.0)
    lower, upper = (box[0] + [0, 0, 0.9], box[1]), (box[0] - [0, 0, 0.9], box[1])
    fixtures = [MeshFixture(lower), MeshFixture(upper)]
    control = Controller(fixtures, SphereTool(0.2))
    poses, _, last = led(control, (0.0, 0, 0.02))
    before = [
        max(0.0, depth_of(mesh, f, poses[0], 0.2)) for mesh, f in zip((lower, upper), fixtures, strict=True)
    ]
    after = [
        max(0.0, depth_of(mesh, f, poses[-1], 0.2)) for mesh, f in zip((lower, upper), fixtures, strict=True)
    ]
    assert all(a <= b + 1e-9 for a, b in zip(after, before, strict=True))
    assert last.status == "infeasible" and not last.motion.any()


@pytest.mark.parametrize("name", ["rough", "flipped", "wall", "spikes", "fan"])
def test_depth_falls_from_anywhere(name):
    mesh = {"rough": rough(), "flipped": flipped(rough()), "wall": wall(), "fan": fan()}.get(name, HARD[name])
    fixture = MeshFixture(mesh)
    control = Controller([fixture], SphereTool(0.8))
    rng, out = np.random.default_rng(2), 0
    for _ in range(12):
        x = mesh[0][rng.integers(len(mesh[0]))] * rng.uniform(0.6, 1.02) + 0.2 * rng.normal(size=3)
        poses, steps, last = led(control, x)
        depths = np.array([depth_of(mesh, fixture, x, 0.8) for x in poses])
        assert (np.diff(depths) < 0).all()
        assert last.status in ("free", "infeasible")
        out += last.status == "free"
        if last.status == "free":
            assert depths[-1] <= TOUCHING
        if steps:
            assert lengths(steps).max() <= 0.25 + 1e-12
    assert out >= (3 if name in ("spikes", "fan") else 10)


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(0.02, 1.0))
def test_never_jumps_through_a_wall(seed, max_step):
    """Too near to one sheet, with another behind: the other is not passed."""
    rng = np.random.default_rng(seed)
    lower = plate(15, 8.0)
    gap = rng.uniform(0.05, 0.6)
    mesh = together(lower, (lower[0] + [0, 0, gap], lower[1]))
    control = Controller([MeshFixture(mesh)], SphereTool(0.5), max_step=max_step)
    poses, _, _ = led(control, np.r_[rng.uniform(-1, 1, 2), rng.uniform(0.001, gap - 0.001)])
    assert all(0 < pose[2] < gap for pose in poses)


def test_slack_is_not_inside():
    fixture = MeshFixture(plate(), slack=Slack(0.4))
    control = Controller([fixture], SphereTool(1.0))
    assert control.lead_out([0.3, 0.2, 0.7]).status == "free"
    poses, _, last = led(control, [0.3, 0.2, 0.3])
    assert last.status == "free" and poses[-1][2] == pytest.approx(0.6, abs=2e-3)


SHAFT = ShaftTool(1.0, 0.6, 20.0)


def exact_depth(fixture, tool, pose):
    """Deepest of the points of capsules' axes, one each 0.02 mm; bodies one after the other."""
    deepest = []
    for body in tool.bodies:
        count = 1 + int(np.linalg.norm(body[3:6] - body[:3]) / 0.02)
        local = body[:3] + np.linspace(0, 1, count)[:, None] * (body[3:6] - body[:3])
        points = np.array([moved(pose, np.zeros(6))[:3] + turn_of(pose) @ point for point in local])
        distances = fixture.distances(points)
        within = [fixture.closed and fixture.index.inside(point) for point in points]
        deepest.append((body[6] + np.where(within, 1, -1) * distances).max())
    return max(deepest)


def turn_of(pose):
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(pose[3:]).as_matrix()


@pytest.mark.parametrize(
    "start", [(0.3, 0.2, 4.5, 0, 0, 0), (0.3, 4.5, 0, 0, 0.3, 0), (0, 0, 1.5, 0.4, 0, 0)]
)
def test_shaft_out_of_a_ball(start):
    fixture = MeshFixture(ball())
    poses, steps, last = led(Controller([fixture], SHAFT), start)
    assert last.status == "free"
    depths = [exact_depth(fixture, SHAFT, pose) for pose in poses]
    assert (np.diff(depths) < 0).all() and depths[-1] <= TOUCHING
    assert not any(step.motion[3:].any() for step in steps)  # it is not turned
    assert lengths(steps).max() <= 0.25 + 1e-12


def box_with_a_hole():
    """A thick plate with a square hole 1.3 mm wide along z, as 16 rectangles."""
    half, hole, top = 6.0, 0.65, 3.0
    squares = [
        [[s * a, t * a, z] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        for z in (-top, top)
        for a in (half, hole)
    ]
    vertices = np.array(squares).reshape(-1, 3)  # low outer, low hole, high outer, high hole
    quads = []
    for k in range(4):
        n = (k + 1) % 4
        quads += [[k, n, 8 + n, 8 + k], [4 + n, 4 + k, 12 + k, 12 + n]]
        quads += [[4 + k, 4 + n, n, k], [8 + k, 8 + n, 12 + n, 12 + k]]
    faces = np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])
    return vertices, faces


def test_shaft_backwards_out_of_a_hole():
    """A tool as wide as its shaft stands in a hole that is a little too narrow: back is the only way."""
    mesh = box_with_a_hole()
    fixture = MeshFixture(mesh)
    assert fixture.closed and not fixture.index.inside([0.01, 0.02, 0.1])
    tool = ShaftTool(0.7, 0.7, 20.0)
    poses, steps, last = led(Controller([fixture], tool), (0.0, 0.0, 0.5, 0, 0, 0))
    assert last.status == "free"
    along = np.array([step.motion for step in steps])
    assert np.abs(along[:, :2]).max() < 1e-9 and (along[:, 2] > 0).all()
    assert poses[-1][2] > 3.0
    # The same tip without a shaft finds nothing better either.
    assert led(Controller([fixture], SphereTool(0.7)), (0.0, 0.0, 0.5))[2].status in ("free", "infeasible")


def test_a_pierced_sheet_lets_the_tip_back_only_if_it_is_no_thicker():
    fixture = MeshFixture(plate())
    thin = ShaftTool(0.5, 0.5, 20.0)
    poses, _, last = led(Controller([fixture], thin), (0.3, 0.2, -2.0, 0, 0, 0))
    assert last.status == "free" and poses[-1][2] == pytest.approx(0.5, abs=0.05)
    poses, _, last = led(Controller([fixture], SHAFT), (0.3, 0.2, -2.0, 0, 0, 0))
    assert last.status == "infeasible" and -2 < poses[-1][2] < -0.3


def test_shaft_from_anywhere_comes_to_an_end_and_no_deeper():
    """Backwards a shaft's depth is known to half of its spheres' distance, from start to end."""
    fixture = MeshFixture(rough())
    out = LeadOut([fixture], SHAFT, 0.25)
    half = 0.5 * np.linalg.norm(covering_spheres(SHAFT)[2, :3] - covering_spheres(SHAFT)[1, :3])
    rng, ended = np.random.default_rng(5), []
    for _ in range(6):
        x = rng.normal(size=3)
        pose = np.r_[4.6 * x / np.linalg.norm(x), rng.normal(size=3)]
        before = out.depth(pose)
        for _ in range(300):
            step = out.step(pose)
            if step.status != "led out":
                break
            pose = moved(pose, step.motion)
            assert out.depth(pose).max() <= max(before.max(), 0.0) + half + 1e-4
        ended.append(step.status)
        assert out.step(pose).status == step.status  # asked again it does not begin anew
    assert set(ended) <= {"free", "infeasible"} and "free" in ended


def test_spheres_cover_the_tool():
    rng = np.random.default_rng(0)
    for tool in (SHAFT, ShaftTool.from_drill()):
        spheres = covering_spheres(tool)
        for start, end, radius in ((body[:3], body[3:6], body[6]) for body in tool.bodies):
            around = rng.normal(size=(400, 3))
            surface = start + rng.random((400, 1)) * (end - start)
            surface = surface + radius * around / np.linalg.norm(around, axis=1, keepdims=True)
            inside = np.linalg.norm(surface[:, None] - spheres[:, :3], axis=2) <= spheres[:, 3] + 1e-9
            assert inside.any(axis=1).all()
        assert spheres[:, 3].max() <= 1.04 * tool.bodies[:, 6].max()


def test_bad_input():
    out = LeadOut([MeshFixture(ball())], SphereTool(1.0), 0.25)
    with pytest.raises(InputError, match="pose: expected 3"):
        out.step(np.zeros(6))
    with pytest.raises(InputError, match="finite"):
        out.step([0, np.nan, 0])
