"""What the page of Algorithm 1 draws and counts is what the methods do."""

import numpy as np
import pandas as pd
import pytest
from fixture_cases import ball, flipped, rough
from matplotlib.figure import Figure

from study.errors import InputError
from study.experiments.fixture_algorithm import (
    METHODS,
    cycles_in_space,
    decide,
    needed_planes,
    places,
)
from study.experiments.fixture_pushes import (
    PushSettings,
    Surface,
    comparison,
    push,
    pushing_claims,
    winding_number,
)
from study.fixtures import Controller, MeshFixture, SphereTool
from study.plots.fixture_algorithm import (
    allowed_part,
    comparison_figure,
    convexity_figure,
    decisions_figure,
    half_plane,
    plane_figure,
)


def raised(point):
    return np.array([point[0], 0.0, point[1]])


@pytest.mark.parametrize("place", places(), ids=lambda place: place.title)
def test_drawn_planes_give_the_motion_of_the_controller(place):
    fixture = MeshFixture(place.mesh())
    for method in ("exact", "published"):
        control = Controller([fixture], SphereTool(place.radius), place.max_step, method=method)
        step = control.step(raised(place.position), raised(place.desired))
        decision = decide(place, method)
        np.testing.assert_allclose(raised(decision.motion), step.motion, atol=2e-6)
        assert decision.stopped == step.stopped
        np.testing.assert_allclose(np.linalg.norm(decision.normals, axis=1), 1.0, atol=1e-9)


def test_places_show_what_is_said_of_them():
    concave, convex, hole, turned = places()
    for place in (concave, convex):
        exact, published = decide(place, "exact"), decide(place, "published")
        np.testing.assert_allclose(exact.motion, published.motion, atol=1e-5)
    naive = decide(convex, "all planes")
    assert naive.stopped or naive.distance > 0.1
    assert np.allclose(decide(concave, "all planes").motion, decide(concave, "exact").motion, atol=1e-5)
    assert decide(hole, "published").motion[1] > 0.1  # out, though the hand leads in
    assert decide(hole, "exact").motion[1] == pytest.approx(hole.desired[1], abs=1e-6)
    assert len(decide(turned, "published").normals) == 0 and decide(turned, "published").distance < -0.5
    for place in places():
        assert decide(place, "none").distance < -0.1
        assert decide(place, "exact").distance > -1e-9


def test_planes_as_they_read_are_those_of_the_compiled_step():
    fixture = MeshFixture(rough(subdivisions=3))
    control = Controller([fixture], SphereTool(0.4), 0.5)
    rng, met = np.random.default_rng(0), 0
    for _ in range(60):
        x = rng.normal(size=3)
        x *= 5.9 / np.linalg.norm(x)
        if fixture.index.inside(x) or fixture.distances(x[None])[0] < 0.41:
            continue
        towards = fixture.index.nearest(x[None]).points[0] - x
        desired = 0.4 * towards / np.linalg.norm(towards) + 0.15 * rng.normal(size=3)
        desired *= min(1, 0.5 / np.linalg.norm(desired))
        normals, _, motion = needed_planes(fixture, x, 0.4, desired)
        np.testing.assert_allclose(motion, control.step(x, desired).motion, atol=1e-5)
        met += len(normals) > 0
    assert met > 5
    with pytest.raises(InputError, match="outside"):
        needed_planes(fixture, fixture.mesh.vertices[0], 0.4, np.zeros(3))


def test_half_planes_cut_what_they_should():
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])

    def area(polygon):
        x, y = polygon.T
        return 0.5 * abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) if len(polygon) > 2 else 0.0

    assert area(half_plane(np.array([1.0, 0]), np.array([0.5, 0]), square)) == pytest.approx(3.0)
    assert area(half_plane(np.array([0.6, 0.8]), np.array([9.0, 9]), square)) == 0.0
    normals, points = np.array([[1.0, 0], [0, 1]]), np.zeros((2, 2))
    assert area(allowed_part(normals, points, 0.5, square)) == pytest.approx(1.5**2)


def test_winding_number_tells_inside_also_of_an_open_surface():
    vertices, faces = ball()
    closed, open_ = MeshFixture((vertices, faces)), MeshFixture((vertices, faces[5:]))
    rng = np.random.default_rng(0)
    for _ in range(40):
        x = rng.normal(size=3) * 4
        inside = np.linalg.norm(x) < 5
        if abs(np.linalg.norm(x) - 5) > 0.2:
            assert winding_number(closed, x) == pytest.approx(float(inside), abs=1e-9)
            assert (winding_number(open_, x) > 0.5) == inside


def test_pushes_count_what_happened():
    whole = MeshFixture(ball())
    case = Surface("turned", MeshFixture(flipped(ball(), 0.2)), whole)
    settings = PushSettings(starts=20, cycles=12)
    table = comparison([Surface("smooth, convex", whole, whole), case], settings)
    assert table["method"].tolist() == list(METHODS) * 2
    rows = table.set_index(["surface", "method"])
    assert rows.loc[("turned", "none"), "entered_pct"] > 50
    assert rows.loc[("turned", "published"), "entered_pct"] > 0
    assert rows.loc[("turned", "exact"), "entered_pct"] == rows.loc[("turned", "exact"), "stuck_pct"] == 0
    assert rows.loc[("smooth, convex", "published"), "entered_pct"] == 0
    assert (rows["progress_ratio"] <= 1 + 1e-9).all()
    for one in push(case, "exact", settings, 0):
        gaps = case.fixture.distances(one.track[1:]) - settings.radius
        assert gaps.min() == pytest.approx(one.least, abs=1e-12)
        steps = np.linalg.norm(np.diff(one.track, axis=0), axis=1)
        assert steps.sum() == pytest.approx(one.given) and steps.max() <= settings.max_step + 1e-12


def test_claims_follow_the_table():
    names = ("smooth, concave", "smooth, convex", "bone")
    rows = [(name, method, 0.0, 0.0, 0.7) for name in names for method in METHODS]
    table = pd.DataFrame(rows, columns=["surface", "method", "entered_pct", "stuck_pct", "progress_ratio"])
    table.loc[table["method"] == "none", "entered_pct"] = 90.0
    fine = [claim.holds for claim in pushing_claims(table)]
    assert fine == [True, True, False, True, True, True, True]
    table.loc[(table["surface"] == "bone") & (table["method"] == "published"), "entered_pct"] = 2.0
    table.loc[(table["surface"] == "bone") & (table["method"] == "exact"), "stuck_pct"] = 1.0
    table.loc[table["method"] == "none", "entered_pct"] = 10.0
    bad = [claim.holds for claim in pushing_claims(table)]
    assert bad == [False, True, False, True, False, True, False]


def test_cycles_in_space_keep_out():
    for cycle in cycles_in_space():
        for _, _, motion in cycle.planes.values():
            left = cycle.fixture.distances((cycle.position + motion)[None])[0] - cycle.radius
            assert left > -1e-9
        wanted = cycle.fixture.distances((cycle.position + cycle.desired)[None])[0] - cycle.radius
        assert wanted < -0.01


def test_figures():
    scenes = places()[:2]
    settings = PushSettings(starts=2, cycles=2)
    table = comparison([Surface("smooth, convex", MeshFixture(ball()), MeshFixture(ball()))], settings)
    for figure in (
        plane_figure(),
        plane_figure(0.3),
        convexity_figure(),
        decisions_figure(scenes, [[decide(place, method) for place in scenes] for method in METHODS]),
        comparison_figure(table),
    ):
        assert isinstance(figure, Figure)
        figure.canvas.draw()
