"""A tip among surfaces: never in, on the whole way, measured by another library; and it slides freely."""

import numpy as np
import pytest
import trimesh
from fixture_cases import HARD, VtkDistance, closest_points, flipped, plate, rough, wall
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real

from study.errors import InputError
from study.fixtures import Controller, MeshFixture, SphereTool, warm
from study.fixtures.control import _kernels
from study.fixtures.optimisation import nearest_motion
from study.volumes import read_volume

MICROMETRE = 1e-3


def pushed(fixture, control, steps, seed, radius):
    """Positions, desired and given motions of a hand that mostly pushes towards the surface and trembles."""
    rng = np.random.default_rng(seed)
    vertices = fixture.mesh.vertices[fixture.mesh.faces[:, 0]]

    def outside():
        while True:
            x = vertices[rng.integers(len(vertices))] + rng.normal(size=3) * (radius + 0.3)
            free = fixture.distances(x[None])[0] > max(radius, 1e-3) + 1e-3
            if free and not (fixture.closed and fixture.index.inside(x)):
                return x

    x, log = outside(), []
    for k in range(steps):
        if k % 250 == 249 or fixture.distances(x[None])[0] > radius + 2:
            x = outside()
        if k % 40 == 0 or k % 250 == 249:
            towards = fixture.index.nearest(x[None]).points[0] - x
            course = towards / np.linalg.norm(towards) + rng.choice([0.3, 1.0, 3.0]) * rng.normal(size=3)
            course /= np.linalg.norm(course)
        desired = (0.1 * course + 0.05 * rng.normal(size=3)) * rng.choice([0.02, 0.3, 1, 2])
        step = control.step(x, desired)
        log.append((x, desired, step))
        x = x + step.motion
    return log


@pytest.mark.parametrize("radius", [0.0, 0.5, 2.5])
@pytest.mark.parametrize("name", HARD)
def test_never_in(name, radius):
    fixture = MeshFixture(HARD[name])
    log = pushed(fixture, Controller([fixture], SphereTool(radius)), 1500, 7, radius)
    other = VtkDistance(HARD[name])
    met = [entry for entry in log if entry[2].status == "constrained"]
    # A point seldom meets a needle.
    assert len(met) > (0 if (name, radius) == ("spikes", 0.0) else 300)
    assert {step.status for _, _, step in log} <= {"free", "constrained"}
    for x, _, step in met:
        for part in (0.3, 0.7, 1.0):
            assert other(x + part * step.motion) > radius
        assert np.linalg.norm(step.motion) <= 0.25 + 1e-12
    # The control: what the hand wanted would have gone in, by far more than what is tolerated.
    if radius:
        wanted = [other(x + d * min(1, 0.25 / np.linalg.norm(d))) for x, d, _ in met]
        assert min(wanted) < radius - 100 * MICROMETRE
    else:
        assert any(other.crosses(x, x + d * min(1, 0.25 / np.linalg.norm(d))) for x, d, _ in met)
        assert not any(other.crosses(x, x + step.motion) for x, _, step in log)


def test_never_in_real_bone():
    volume = read_volume(real("temporal_bone/RT143/labels_0p38.nrrd"))
    bone = next(name for name, label in volume.names.items() if label == 1)
    fixture = MeshFixture.from_volume(volume, bone, smooth_mm=0.2)
    mesh = fixture.mesh
    assert len(mesh.faces) > 100_000
    other = VtkDistance((mesh.vertices, mesh.faces))
    for radius in (0.5, 2.5):
        log = pushed(fixture, Controller([fixture], SphereTool(radius)), 1500, 11, radius)
        met = [(x, step.motion) for x, _, step in log if step.status == "constrained"]
        assert len(met) > 500
        assert min(other(x + part * motion) for x, motion in met for part in (0.5, 1.0)) > radius


def plain_step(corners, keep, x, desired):
    """As it reads: impacts by bisection of the distance to all triangles, planes there, another solver."""
    level = keep + _kernels.RESERVE - _kernels.HYSTERESIS
    rows, least, motion = np.zeros((0, 3)), np.zeros(0), desired

    def near(t):
        points = closest_points(corners, x + t * motion)
        gaps = np.linalg.norm(x + t * motion - points, axis=1)
        return gaps.min(), points[gaps.argmin()]

    for _ in range(40):
        when = next((t for t in np.linspace(0, 1, 101) if near(t)[0] < level), None)
        if when is None:
            return motion, len(rows)
        low, high = max(when - 1 / 100, 0.0), when
        for _ in range(45):
            middle = (low + high) / 2
            low, high = (low, middle) if near(middle)[0] < level else (middle, high)
        point = near(low)[1]
        normal = (x + low * motion - point) / np.linalg.norm(x + low * motion - point)
        rows = np.vstack([rows, normal])
        least = np.append(least, min(0.0, keep + _kernels.RESERVE - normal @ (x - point)))
        motion = nearest_motion(rows, least, desired, "nnls")
    raise AssertionError("no end")


@pytest.mark.parametrize("name", ["plate", "rough"])
def test_as_it_reads(name):
    mesh = plate(8, 6.0) if name == "plate" else rough(subdivisions=2)
    fixture = MeshFixture(mesh)
    log = pushed(fixture, Controller([fixture], SphereTool(0.8)), 400, 5, 0.8)
    met = [entry for entry in log if entry[2].status == "constrained"]
    assert len(met) > 100
    corners = fixture.mesh.vertices[fixture.mesh.faces]
    for x, desired, step in met[::20]:
        motion, _ = plain_step(corners, 0.8, x, desired * min(1, 0.25 / np.linalg.norm(desired)))
        np.testing.assert_allclose(step.motion, motion, atol=1e-5)


@given(seed=st.integers(0, 2**31), keep=st.floats(0.01, 2.0), thin=st.sampled_from([1.0, 1e-4]))
@settings(deadline=None, max_examples=60)
def test_impact_of_one_triangle(seed, keep, thin):
    rng = np.random.default_rng(seed)
    triangle = rng.normal(size=(1, 3, 3))
    triangle[0, 2] = triangle[0, 0] + 0.3 * (triangle[0, 1] - triangle[0, 0]) + thin * triangle[0, 2]
    x, dx = 2 * rng.normal(size=3), 3 * rng.normal(size=3)

    def distance(t):
        return np.linalg.norm(x + t * dx - closest_points(triangle, x + t * dx)[0])

    if distance(0) < keep + 1e-5:
        return
    plane = np.empty(4)
    when = _kernels.impact_of(triangle.reshape(1, 9), x, dx, keep, plane)
    along = np.array([distance(t) for t in np.linspace(0, min(when, 1), 100)])
    assert (along > keep).all()
    if when < np.inf:
        assert distance(when) == pytest.approx(keep, abs=2e-6)
        # All of the triangle behind the plane, the ball at the impact before it.
        assert (triangle[0] @ plane[:3] <= plane[3] + 1e-12).all()
        assert plane[:3] @ (x + when * dx) - plane[3] >= keep - 1e-9


@pytest.mark.parametrize("count", [4, 30, 200])
@pytest.mark.parametrize("press", [0.0, 1e-4, 0.01, 0.1, 0.2])
def test_sliding_loses_nothing(count, press):
    control = Controller([MeshFixture(plate(count))], SphereTool(1.0))
    x, asked, made = np.array([-4, 0.1, 1.02]), 0.0, 0.0
    for k in range(32):
        desired = np.array([0.2, 0.05 * np.sin(k), -press])
        desired *= min(1, 0.25 / np.linalg.norm(desired))
        step = control.step(x, desired)
        x = x + step.motion
        asked += np.linalg.norm(desired[:2])
        made += np.linalg.norm(step.motion[:2])
    assert made / asked == pytest.approx(1.0, abs=1e-3)
    assert 1.0 < x[2] <= 1.02
    if press >= 0.01:
        assert x[2] == pytest.approx(1.0, abs=1e-5)


def test_whichever_way_triangles_face():
    one, other = MeshFixture(rough()), MeshFixture(flipped(rough(), 0.5))
    log = pushed(one, Controller([one], SphereTool(0.7)), 500, 3, 0.7)
    control = Controller([other], SphereTool(0.7))
    for x, desired, step in log:
        np.testing.assert_allclose(control.step(x, desired).motion, step.motion, atol=1e-9)


def test_both_trees_give_the_same_motion():
    one, other = (MeshFixture(rough(), index=kind) for kind in ("aabb", "pd"))
    log = pushed(one, Controller([one], SphereTool(0.7)), 500, 3, 0.7)
    control = Controller([other], SphereTool(0.7))
    for x, desired, step in log:
        again = control.step(x, desired)
        np.testing.assert_allclose(again.motion, step.motion, atol=1e-6)
        assert again.clearance == pytest.approx(step.clearance, abs=1e-6)


def test_a_slot_as_wide_as_the_tool():
    sheets = [np.array([[-9.0, -9, z], [9, -9, z], [0, 18, z]]) for z in (-1.0, 1.0)]
    mesh = np.concatenate(sheets), np.arange(6).reshape(2, 3)
    control = Controller([MeshFixture(mesh)], SphereTool(1.0 - 1e-9))
    x, rng = np.zeros(3), np.random.default_rng(0)
    for _ in range(2000):
        step = control.step(x, 0.1 * rng.normal(size=3))
        assert step.status in ("free", "constrained")
        x = x + step.motion * [0.1, 0.1, 1]
        assert abs(x[2]) < 1e-6
    # and on, sideways, all the same
    step = control.step(x, [0.1, 0, 0.1])
    assert step.motion[0] == pytest.approx(0.1, abs=1e-9)


def test_planes_that_are_kept_hold_of_all_triangles_and_change_nothing():
    fixture = MeshFixture(rough())
    control = Controller([fixture], SphereTool(0.7))
    log = pushed(fixture, control, 600, 3, 0.7)
    planes, index = control._steps._planes, fixture.index
    known = np.flatnonzero(np.isfinite(planes[:, 3]) & (np.linalg.norm(planes[:, :3], axis=1) > 0))
    assert len(known) > 50
    for leaf in known:
        corners = index.triangles[index.ends[leaf] : index.ends[leaf + 1]].reshape(-1, 3)
        assert (corners @ planes[leaf, :3] <= planes[leaf, 3] + 1e-12).all()
    for x, desired, step in log[::4]:
        fresh = Controller([fixture], SphereTool(0.7)).step(x, desired)
        np.testing.assert_allclose(fresh.motion, step.motion, atol=1e-6)
        assert fresh.clearance == pytest.approx(step.clearance, abs=1e-6)


def test_clearance_is_exact():
    fixture = MeshFixture(rough())
    log = pushed(fixture, Controller([fixture], SphereTool(0.5), far_mm=3.0), 300, 9, 0.5)
    for x, _, step in log:
        left = fixture.distances((x + step.motion)[None])[0] - 0.5
        assert step.clearance == (pytest.approx(left, abs=1e-9) if left < 3.0 else np.inf)


def test_structures_with_different_clearances():
    ball = trimesh.creation.icosphere(3, 2.0)
    left, right = (np.add(ball.vertices, [s * 6, 100, 0]) for s in (-1, 1))
    faces = np.asarray(ball.faces)
    fixtures = [MeshFixture((left, faces), "bone"), MeshFixture((right, faces), "nerve", clearance_mm=0.7)]
    control = Controller(fixtures, SphereTool(1.0))
    for end, side, keep in ((-1, left, 1.0), (1, right, 1.7)):
        x = np.array([0.0, 100, 0])
        for _ in range(60):
            step = control.step(x, [0.2 * end, 0.0, 0.0])
            x = x + step.motion
        assert VtkDistance((side, faces))(x) == pytest.approx(keep, abs=1e-4)
        assert step.clearance == pytest.approx(0, abs=1e-4)


def test_too_long_a_step_is_shortened_and_reported():
    control = Controller([MeshFixture(plate(4))], SphereTool(1.0), max_step=0.2)
    step = control.step([0, 0, 5], [3.0, 0, 4.0])
    np.testing.assert_allclose(step.motion, [0.12, 0, 0.16])
    assert step.clipped
    assert not control.step([0, 0, 5], [0.2, 0, 0]).clipped


@pytest.mark.parametrize("desired", [[0.1, 0, 0], [0, 0, 0.1]])
def test_a_tool_that_starts_inside_is_stopped_and_never_pushed(desired):
    step = Controller([MeshFixture(plate(10))], SphereTool(1.0)).step([0, 0, 0.9], desired)
    assert step.status == "inside"
    assert step.stopped
    assert step.motion.tolist() == [0, 0, 0]
    assert step.clearance == pytest.approx(-0.1)
    on = Controller([MeshFixture(plate(10))], SphereTool(0.0)).step([0.1, 0.2, 0], desired)
    assert on.status == "inside"


@pytest.mark.parametrize("index", ["aabb", "pd"])
@pytest.mark.parametrize("radius", [0.0, 0.5])
def test_within_a_closed_surface_although_far_from_it(index, radius):
    fixture = MeshFixture(flipped(rough()), index=index)
    control = Controller([fixture], SphereTool(radius))
    for x in ([0.3, 0.2, 0.1], [0, 0, 9.0], [0.3, 0.2, 0.1], [0.31, 0.2, 0.1]):  # the second is outside
        step = control.step(x, [0.01, 0, 0])
        left = fixture.distances(np.array([x]))[0]
        if x[2] > 1:
            assert step.status == "free"
        else:
            assert step.status == "inside"
            assert step.motion.tolist() == [0, 0, 0]
            assert step.clearance == pytest.approx(-left - max(radius, 1e-3))


def test_a_tool_that_is_moved_by_others_is_measured_again():
    control = Controller([MeshFixture(plate(10))], SphereTool(1.0))
    assert control.step([0, 0, 1.1], [0, 0, -0.2]).status == "constrained"
    assert control.step([0, 0, 0.995], [0, 0, 0.1]).status == "inside"
    assert control.step([0, 0, 1.0], [0, 0, 0.1]).status == "free"
    assert control.step([0, 0, 0.2], [0, 0, 0.1]).status == "inside"
    assert control.step([0, 0, -1.5], [0, 0, -0.1]).status == "free"  # an open surface has two good sides


def test_more_planes_than_there_is_room_for_stop(monkeypatch):
    fixture = MeshFixture(wall())
    control = Controller([fixture], SphereTool(1.0))
    control._steps._scratch = (np.empty((0, 4)), *control._steps._scratch[1:])
    step = control.step([0, 0, 1.05], [0, 0, -0.2])
    assert step.status == "unsettled"
    assert step.motion.tolist() == [0, 0, 0]


def test_near_ones_are_never_left_out_for_want_of_room():
    fixture = MeshFixture(rough())
    x, desired = np.array([0.0, 0, 9.0]), np.array([0, 0, -0.2])
    one, other = (Controller([fixture], SphereTool(2.0)) for _ in range(2))
    other._steps._near = np.empty(1, np.int64)
    for _ in range(30):
        a, b = one.step(x, desired), other.step(x, desired)
        np.testing.assert_allclose(a.motion, b.motion, atol=1e-9)
        x = x + a.motion
    assert len(other._steps._near) > 1
    assert a.status == "constrained"


def test_nothing_is_compiled_in_the_loop_after_warming():
    warm()
    before = len(_kernels.step.signatures)
    fixtures = [MeshFixture(plate(10)), MeshFixture(rough(), clearance_mm=0.5)]
    Controller(fixtures[:1], SphereTool(0.0)).step([0, 0, 1], [0, 0, 1])
    Controller(fixtures, SphereTool(1.0)).step([0, 0, 9], [0, 0, 1])
    assert len(_kernels.step.signatures) == before


def test_bad_input():
    fixture = MeshFixture(plate(4))
    for radius in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="radius"):
            SphereTool(radius)
    with pytest.raises(InputError, match="at least one"):
        Controller([], SphereTool(1.0))
    for length in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="max_step"):
            Controller([fixture], SphereTool(1.0), max_step=length)
    with pytest.raises(InputError, match="far_mm"):
        Controller([fixture], SphereTool(1.0), far_mm=-1.0)
    control = Controller([fixture], SphereTool(1.0))
    for position, desired in (([0, 0, np.nan], [0, 0, 0]), ([0, 0, 5], [np.inf, 0, 0])):
        with pytest.raises(InputError, match="finite"):
            control.step(position, desired)
    with pytest.raises(InputError, match="three coordinates"):
        control.step([0, 0, 5, 0, 0, 0], [0, 0, 0])
