"""Features and simulation: the pages' experiments, pictures and animation."""

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from study.errors import InputError
from study.experiments.fixture_arm_run import stretch_runs
from study.experiments.fixture_bone import (
    cavity,
    guards,
    outside,
    reaching_waypoints,
    shaft_gap,
    signed_distances,
    simulation_claims,
    status_table,
    summary_table,
    tip_gaps,
    unguided,
)
from study.experiments.fixture_features import (
    covered_radius,
    feature_claims,
    groove,
    shaft_covers,
    slack_depths,
    tilted_drill,
    tips_in_groove,
    wall_and_nerve,
)
from study.fixtures import Controller, ShaftTool, Slack, SphereTool
from study.fixtures.hands import ScriptedHand, Tremor
from study.fixtures.simulation import simulate
from study.plots.fixture_features import clearance_over_time, slack_figure, tips_figure
from study.rendering import approach_view
from study.rendering.fixtures import Track, animate, guided_figure, tool_meshes
from study.specimens import specimen

RADIUS = 2.5
KEPT = {"facial_nerve": 0.5, "labyrinth": 0.3}


@pytest.fixture(scope="module")
def bone():
    return specimen("CH01")


@pytest.fixture(scope="module")
def fixtures(bone):
    return guards(bone.anatomy, KEPT)


@pytest.fixture(scope="module")
def operation(bone, fixtures):
    """A run with fixtures, and where the hand goes without."""
    way = reaching_waypoints(bone, KEPT)
    hand = ScriptedHand(way, speed_mm_s=12.0, tremor=Tremor(0))
    run = simulate(Controller(fixtures, SphereTool(RADIUS)), hand, way[0], hand.seconds)
    return run, unguided(hand, way[0], hand.seconds)


@pytest.fixture(scope="module")
def tilt(bone):
    return tilted_drill(bone, cycles=150)


# Feature 1


@pytest.mark.parametrize("opening_deg", [60.0, 90.0, 140.0])
def test_a_ball_reaches_a_corner_as_far_as_it_can(opening_deg):
    radii = [0.5, 1.0, 2.0]
    _, _, table = tips_in_groove(radii, opening_deg)
    possible = np.array(radii) / np.sin(np.deg2rad(opening_deg) / 2)
    np.testing.assert_allclose(table["possible_to_corner_mm"], possible)
    np.testing.assert_allclose(table["centre_to_corner_mm"], possible, atol=0.01)
    assert (table["centre_to_wall_mm"] >= radii).all()
    assert (table["cycles_constrained"] > 50).all()
    assert (table["cycles_stopped"] == 0).all()


# Feature 2


def test_pressing_harder_goes_deeper_up_to_the_slack_and_not_beyond():
    slack = Slack(0.6, weight=0.2)
    pushes = [0.02, 0.06, 0.1, 0.15, 0.25]
    table, over_time = slack_depths(pushes, [slack, None])
    rows = dict(list(table.groupby("structure", sort=False)))
    soft, hard = (part["depth_mm"].to_numpy() for part in rows.values())
    assert (np.diff(soft[:3]) > 0.1).all()  # 0.1, 0.3, 0.5 mm
    np.testing.assert_allclose(soft, np.minimum(np.array(pushes) / slack.weight, slack.depth_mm), atol=1e-4)
    assert table["deepest_mm"].max() <= slack.depth_mm
    assert (hard <= 0).all()
    assert all(np.ptp(depth[150:]) < 1e-3 for depth in over_time.values())


def test_the_wall_is_cut_and_the_nerve_behind_it_is_not(bone):
    table = wall_and_nerve(bone, 1.0, cycles=150).set_index(["setting", "structure"])["least_distance_mm"]
    whole, cut = table.xs("bone", level="structure")
    assert whole >= 0
    assert -1.0 <= cut < -0.5
    assert (table.xs("facial_nerve", level="structure") >= 0).all()


# Feature 3


def test_spheres_cover_less_than_the_shaft_and_capsules_all_of_it():
    assert covered_radius(1.0) == pytest.approx(np.sqrt(1 - 0.44**2), abs=1e-6)
    table = shaft_covers(1.2).set_index("shaft")
    assert table.loc["spheres as printed", "missing_pct"] == pytest.approx(10.2, abs=0.05)
    assert (table.loc[["spheres, inflated", "capsule"], "missing_pct"] == 0).all()
    assert table.loc["capsule", "too_thick_pct"] == 0 < table.loc["spheres, inflated", "too_thick_pct"]


def test_a_controller_that_knows_the_shaft_stops_the_tilt_at_the_rim(tilt):
    rows = tilt.table.set_index("controller")
    assert rows.loc["tip only", "least_gap_of_shaft_mm"] < -1.0
    assert rows.loc["tip only", "tilt_reached_deg"] == pytest.approx(55.0)
    assert rows.loc["tip and shaft", "least_gap_of_shaft_mm"] >= 0.0
    assert rows.loc["tip and shaft", "tilt_reached_deg"] < 50.0
    assert rows.loc["tip and shaft", "cycles_constrained"] > 20


def test_gap_of_a_shaft_beside_a_corner_of_bone(bone):
    wall = cavity(bone)
    tool = ShaftTool(1.0, shaft_radius=0.7, length=20.0)
    pose = np.r_[outside(bone, 30.0), 0.0, 0.0, 0.0]
    ends = np.linspace(pose[:3], pose[:3] + np.array([0, 0, 20.0]), 400)
    assert shaft_gap(wall, tool, pose) == pytest.approx(wall.distances(ends).min() - 0.7, abs=1e-3)


def test_claims_fail_where_something_is_wrong(tilt, bone):
    _, _, tips = tips_in_groove([1.0])
    slack, _ = slack_depths([0.1], [Slack(0.5)], cycles=90)
    wall = wall_and_nerve(bone, 1.0, cycles=60)
    good = feature_claims(tips, slack, wall, shaft_covers(), tilt)
    assert all(claim.holds for claim in good)
    bad = feature_claims(
        tips.assign(centre_to_wall_mm=0.999),
        slack.assign(deepest_mm=0.502, depth_mm=0.6),
        wall.assign(least_distance_mm=-0.1),
        shaft_covers().assign(missing_pct=0.0),
        tilt,
    )
    assert [claim.holds for claim in bad] == [False, True, False, False, False, False, True, True]


# The simulated operation


def test_with_fixtures_the_burr_keeps_its_distance_and_without_it_does_not(operation, fixtures):
    run, free = operation
    gaps = {
        "with fixtures": tip_gaps(fixtures, run.poses[::4], RADIUS),
        "without": tip_gaps(fixtures, free[::4], RADIUS),
    }
    near = summary_table(gaps, KEPT)
    guided, loose = near[near["tool"] == "with fixtures"], near[near["tool"] == "without"]
    assert (guided["least_mm"] >= guided["to_be_kept_mm"]).all()
    assert (guided["time_inside_pct"] == 0).all()
    assert (loose["least_mm"] < -1.0).all()
    assert all(claim.holds for claim in simulation_claims(run, near))
    swapped = near.assign(tool=near["tool"].map({"with fixtures": "without", "without": "with fixtures"}))
    assert [claim.holds for claim in simulation_claims(run, swapped)] == [False, False, True]
    table = status_table(run)
    assert table["cycles"].sum() == len(run.log)
    assert table["share_pct"].sum() == pytest.approx(100)
    assert set(table["status"]) == {"free", "constrained"}
    figure = clearance_over_time(run.times[::4], gaps, KEPT)
    assert [axes.get_ylabel() for axes in figure.axes] == ["burr to structure, mm"] * 2


def test_signed_distances_on_both_sides(bone, fixtures):
    nerve = fixtures[0]
    voxels = bone.anatomy.points(np.argwhere(bone.anatomy.mask("facial_nerve")))
    found = signed_distances(
        nerve, np.array([voxels.mean(axis=0) - 30 * np.eye(3)[0], voxels[len(voxels) // 2]])
    )
    assert found[0] > 20
    assert found[1] < 0


def test_an_arm_comes_to_rest_at_its_reach(fixtures):
    control = Controller(fixtures[:1], SphereTool(RADIUS))
    far = np.array([500.0, 500.0, 500.0])
    logs, table = stretch_runs(control, far, np.zeros(3), [30.0], 3.5)
    log, row = logs[30.0], table.iloc[0]
    assert log["singular_value"].iloc[0] > 1 > 0.01 > row["least_singular_value"]
    assert log["damping"].iloc[0] < 0.01 < 0.1 < row["greatest_damping"]
    assert row["fastest_joint_pct"] <= 100 + 1e-6
    assert row["fastest_in_the_end_pct"] < 5
    assert np.ptp(log["joint_3_deg"].tail(100)) < 0.1


# Pictures


def test_figures_of_features():
    ways, wanted, _ = tips_in_groove([0.5, 1.0], cycles=60)
    assert isinstance(tips_figure(ways, wanted, groove()), Figure)
    figure = slack_figure(*slack_depths([0.05, 0.1], [None, Slack(0.5)], cycles=40))
    assert all("mm" in axes.get_ylabel() for axes in figure.axes)


def test_a_shaft_is_drawn_as_thick_and_as_long_as_it_is():
    tip, shaft = tool_meshes(ShaftTool(2.5, shaft_radius=1.2, length=30.0))
    assert np.ptp(tip.points[:, 0]) == pytest.approx(5.0, abs=0.05)
    low, high = shaft.points.min(axis=0), shaft.points.max(axis=0)
    np.testing.assert_allclose(high - low, [2.4, 2.4, 32.4], atol=0.05)


def test_track_refuses_what_it_cannot_draw():
    places, tool = np.zeros((3, 3)), SphereTool(1.0)
    with pytest.raises(InputError, match="status"):
        Track(places, ["free", "free", "gone"], places, tool)
    with pytest.raises(InputError, match="for each of"):
        Track(places, ["free"], places, tool)


def test_picture_and_animation_of_a_guided_tool(tmp_path, operation, bone):
    run, free = operation
    rows = slice(None, None, 20)
    track = Track(run.poses[rows], ["free", *run.log["status"]][rows], free[rows], run.tool)
    view = approach_view(bone.approach, oblique=True)
    figure = guided_figure(bone.anatomy, track, {"(a)": view}, at=len(track.poses) // 2)
    texts = {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert {"facial nerve", "tool: free", "tool: constrained", "where the hand wants the tip"} <= texts
    files = [tmp_path / f"{n}.gif" for n in range(2)]
    placed = view.around(track.hand.mean(axis=0), 15.0)
    for file in files:
        animate(bone.anatomy, track, placed, file, frames=4, size=(240, 180))
    assert files[0].read_bytes() == files[1].read_bytes()
    with Image.open(files[0]) as film:
        assert film.n_frames == 4
        pictures = []
        for n in range(4):
            film.seek(n)
            pictures.append(np.asarray(film.convert("RGB")).astype(int))
    assert all(np.abs(a - b).max() > 50 for a, b in pairwise(pictures))
    with pytest.raises(InputError, match="two frames"):
        animate(bone.anatomy, track, placed, tmp_path / "none.gif", frames=1)
