"""The validation page's claims, on fewer steps; and its instruments on what is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study.experiments import fixture_meshes as meshes
from study.experiments.fixture_plate import plate_progress
from study.experiments.fixture_validation import (
    TOOLS,
    HandSettings,
    Surface,
    Wander,
    measured,
    summary,
    surfaces,
    validation,
    wander,
)
from study.fixtures import SphereTool


@pytest.fixture(scope="module")
def cases():
    return {case.name: case for case in surfaces(whole_bone=False)}


@pytest.fixture(scope="module")
def found(cases):
    return validation(list(cases.values()), 120, ("point", "tip 0.5 mm", "tip 1 mm"))


def test_the_exact_method_never_lets_in_and_never_stops(found):
    rows = found.rows[found.rows["method"] == "exact"]
    assert (rows["entered_pct"] == 0).all()
    assert (rows["passed"] == 0).all()
    assert (rows["worst_mm"] == 0).all()
    assert (rows["stopped_pct"] == 0).all()


def test_the_control_enters_everywhere(found):
    rows = found.rows[(found.rows["method"] == "none") & (found.rows["tool"] != "point")]
    assert (rows["worst_mm"] > 0.1).all()
    assert (rows["entered_pct"] > 50).all()


def test_algorithm_1_lets_in_and_stops(found):
    rows = found.rows[found.rows["method"] == "published"].set_index(["mesh", "tool"])
    assert (rows.loc["10 % turned round", "entered_pct"] > 0).any()
    assert (rows.loc["bone, 3 % left", "entered_pct"] > 0).any()
    assert (rows.loc["rough ball", "stopped_pct"] > 1).any()
    table = summary(found.rows).set_index(["method", "tool"])
    assert table.loc[("exact", "tip 1 mm"), "entered_pct"] == 0
    assert table.loc[("none", "tip 1 mm"), "entered_pct"] > 50
    assert table["steps"].eq(8 * 120).all()


def test_progress_along_a_plate():
    table = plate_progress((0.0, 0.1, 0.2), (4, 25), cycles=15)
    exact = table[table["method"] == "exact"]
    assert (exact["progress_ratio"] >= 0.98).all()
    assert (exact["worst_mm"] == 0).all()
    pressed = table[(table["method"] == "none") & (table["press_mm"] > 0)]
    assert (pressed["worst_mm"] > 1).all()


def test_what_is_measured_is_how_far_a_tip_was_in(cases):
    ball = cases["rough ball"]
    plain = meshes.plate(20, 12.0)
    plate = Surface("plate", plain, plain, False)

    def run(x, motion):
        x, motion = np.array([x], float), np.array([motion], float)
        return Wander(x, motion, motion, np.array(["free"]), np.zeros(1, bool), np.ones(1, bool))

    tip = SphereTool(1.0)
    assert measured(plate, tip, run([0, 0, 1.5], [0, 0, -0.2])).depths[0] == pytest.approx(-0.3)
    found = measured(plate, tip, run([0, 0, 1.1], [0, 0, -0.2]))
    assert found.depths[0] == pytest.approx(0.1)
    assert not found.crossed[0]
    # In only half-way: through a plate and out on its other side.
    through = measured(plate, tip, run([0.1, 0.2, 1.2], [0, 0, -2.4]))
    assert through.crossed[0]
    assert through.depths[0] == pytest.approx(1.0)
    # Behind a closed surface by the distance as well, here from the middle of the ball.
    deep = measured(ball, tip, run([0, 0, 0], [0, 0, 0.0])).depths[0]
    assert deep == pytest.approx(1.0 + ball.other(np.zeros(3)))


def test_the_same_is_asked_for_whatever_the_method(cases):
    ball, tip = cases["rough ball"], TOOLS["tip 1 mm"]
    one, other = (wander(ball, tip, method, 60, seed=3) for method in ("exact", "none"))
    np.testing.assert_array_equal(one.poses[0], other.poses[0])
    np.testing.assert_array_equal(one.desired[0], other.desired[0])
    again = wander(ball, tip, "exact", 60, seed=3)
    assert again.poses.tobytes() == one.poses.tobytes()
    assert (np.linalg.norm(one.motions, axis=1) <= 0.25 + 1e-12).all()
    assert one.clipped.any()


@given(
    seed=st.integers(0, 2**31),
    count=st.integers(8, 60),  # one alone may be smaller than any anatomy
    radius=st.sampled_from([0.0, 0.3, 1.0]),
    thin=st.sampled_from([1.0, 1e-3]),
)
@settings(deadline=None, max_examples=15)
def test_no_soup_of_triangles_is_entered(seed, count, radius, thin):
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-4, 4, (count, 1, 3)) + rng.normal(size=(count, 3, 3))
    corners[:, 2] = corners[:, 0] + 0.4 * (corners[:, 1] - corners[:, 0]) + thin * corners[:, 2]
    mesh = corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)
    surface, tool = Surface("soup", mesh, mesh, False), SphereTool(radius)
    run = wander(surface, tool, "exact", 80, seed, HandSettings(cycles=40))
    assert not measured(surface, tool, run, (0.3, 0.6, 1.0)).entered.any()
    assert not run.stopped.any()
