"""The page on which hole, robots and margins meet: its tables and pictures."""

import numpy as np
import pandas as pd
import pytest
from access_cases import FEW, planned
from matplotlib.figure import Figure

from study.errors import InputError
from study.experiments import cochlear_access as page
from study.experiments.margin_survey import at_voxel_size
from study.guidance import Repeated
from study.guidance.access import NormalErrors, drill_axes, plan_access, printed_absolute, risk_curve
from study.margins import GrowthSettings
from study.plots.access import (
    axes_at,
    ellipse,
    recess_depth,
    recess_sections,
    risk_against_accuracy,
    section_across,
)
from study.rendering.access import access_figure
from study.specimens import specimen


def drilled(plan, size=0.1, count=60):
    """Holes as a simulation would return them, without simulating."""
    drawn = NormalErrors(size, size, 0.5, [[0.05, 0, 0], [0.1, 0, 0.2]]).sample(count, 3)
    return Repeated(drawn @ drill_axes(plan.entry, plan.target).T, ("occluded",))


@pytest.fixture(scope="module")
def plans():
    plan = planned()
    holes = {"hannover": drilled(plan), "vanderbilt": drilled(plan, 0.2)}
    models = page.error_models(plan, holes)
    return {name: plan.with_errors(model) for name, model in models.items()}, holes


def test_every_error_has_a_row_and_larger_ones_touch_more(plans):
    rows = page.error_rows(*plans)
    assert list(rows.index) == list(plans[0])
    assert rows.loc["simulated Hannover", "simulated_holes"] == 60
    assert rows.loc["simulated Vanderbilt", "stopped_by_the_robot"] == 1
    assert rows.loc["printed absolute", "simulated_holes"] == 0
    order = rows.sort_values("target_rms_mm")
    small, large = order.iloc[0], order.iloc[-1]
    assert large["facial_nerve_probability"] > small["facial_nerve_probability"]
    assert (rows["facial_nerve_low"] <= rows["facial_nerve_probability"]).all()
    np.testing.assert_allclose(rows.loc["simulated Vanderbilt", "target_rms_mm"], 0.2, rtol=0.3)
    points = page.robot_points(rows)
    assert len(points) == 2 * len(rows)


def test_more_holes_know_the_tail_better(plans):
    plan = plans[0]["simulated Vanderbilt"]
    widths = []
    for count in (20, 2000):
        low, high = page.fitted_range(plan, NormalErrors(0.2, 0.2).sample(count, 1))
        assert 0 <= low < high <= 1
        widths.append(np.log(high / low))
    assert widths[1] < widths[0] / 3


def test_errors_fitted_to_image_axes_come_back_in_image_axes(plans):
    plan = plans[0]["simulated Hannover"]
    found = plans[1]["hannover"].values.mean(axis=0)
    np.testing.assert_allclose(plan.risks.errors.mean(axis=0), found, atol=0.02)


def test_required_rows_are_of_what_is_near():
    plan = planned("TB14", 0.4)
    rows = page.required_rows(plan, [1.2, plan.settings.drill_diameter, 6.0])
    assert (rows["needed_with_1.2_mm"] > rows["needed_target_rms_mm"]).all()
    assert (rows["needed_with_6_mm"] == 0).all()
    assert f"needed_with_{plan.settings.drill_diameter:g}_mm" not in rows
    assert rows["planned_clearance_mm"].between(0, 2).all()
    assert rows["needed_target_rms_mm"].is_monotonic_increasing
    assert "facial_nerve" in rows.index
    assert "temporomandibular_joint" not in rows.index


def test_whole_voxels_are_touched_more_often_than_their_centres():
    plan = planned("TB14", 0.4)
    finer = at_voxel_size(plan.anatomy, 0.2)
    rows = page.convention_rows(plan, finer).set_index("voxels", append=True)
    centres, fine, whole = (
        rows.xs(name, level="voxels")
        for name in ("centres, 0.4 mm", "centres, 0.2 mm", "whole voxels, 0.4 mm")
    )
    clearance = "planned_clearance_mm"
    np.testing.assert_allclose(centres[clearance] - whole[clearance], 0.4 * np.sqrt(3) / 2)
    assert fine[clearance].between(whole[clearance], centres[clearance]).all()
    assert (whole["probability"] > fine["probability"]).all()


def test_a_margin_row_says_whether_the_drill_stays_out(plans):
    plan = planned()
    settings = GrowthSettings(registrations=3000, validation_registrations=3000)
    some = {
        "tiny": plan.with_errors(NormalErrors(0.001, 0.001)),
        "printed absolute": plan.with_errors(printed_absolute()),
    }
    rows = page.margin_rows(some, plan.anatomy, settings)
    assert rows.loc["tiny", "margin_mm3"] < rows.loc["printed absolute", "margin_mm3"]
    assert not rows.loc["printed absolute", "drill_stays_out"]
    few = page.margin_rows(some, plan.anatomy, GrowthSettings(registrations=100))
    assert few["margin"].str.contains("registrations: expected at least 2995").all()


def test_bones_without_a_way_say_why():
    assert page.bones_of("") == []
    assert page.bones_of("CH04 TB14") == ["CH04", "TB14"]
    assert len(page.bones_of("all")) == 36
    assert page.bone_rows([], FEW, 0.2).empty
    rows = page.bone_rows(["TB02", "TB14"], FEW, 0.2)
    assert rows.loc["TB02", "way"] == "none"
    assert "blocks" in rows.loc["TB02", "why"]
    assert 1.5 < rows.loc["TB14", "recess_width_mm"] < 3


def test_a_planning_volume_is_no_bone_to_plan_access_on(tmp_path):
    from study.volumes import write_volume

    write_volume(specimen("TB14").planning, tmp_path / "only.nrrd")
    with pytest.raises(InputError, match="anatomy"):
        page.anatomy_case(tmp_path / "only.nrrd")


def test_claims_are_decided_by_what_was_measured(plans):
    margins = pd.DataFrame(
        {"drill_stays_out": [True, False], "drill_touches_nerve": [0.002, 0.5], "accepted": [0.001, 0.001]}
    )
    claims = {c.text: c for c in page.access_claims(plans[0], margins, page.bone_rows([], FEW, 0.2))}
    assert len(claims) == 4
    assert [c.holds for c in claims.values()][2:] == [True, False]
    margins["drill_touches_nerve"] = [0.0005, 0.5]
    claims = page.access_claims(plans[0], margins, page.bone_rows([], FEW, 0.2))
    assert claims[3].holds


# Pictures


def test_the_section_shows_nerve_and_chorda_on_either_side_and_the_drill_in_between():
    plan = planned()
    labels, steps = section_across(plan, recess_depth(plan), 3.0)
    assert labels.shape == (len(steps), len(steps))
    names = plan.anatomy.names
    places = [np.argwhere(labels == names[name]).mean(axis=0) for name in ("facial_nerve", "chorda_tympani")]
    offsets = [steps[np.rint(place).astype(int)] for place in places]
    assert offsets[0] @ offsets[1] < 0
    y, x = np.meshgrid(steps, steps, indexing="ij")
    within = np.hypot(x, y) < plan.settings.drill_radius
    assert not np.isin(labels[within], [names["facial_nerve"], names["chorda_tympani"]]).all()
    structures = {names[name] for name in ("facial_nerve", "chorda_tympani", "labyrinth")}
    assert not structures & set(labels[np.hypot(x, y) < 0.4].tolist())


def test_an_ellipse_holds_its_share_of_the_axes():
    plan = planned("TB14", 0.4)
    points = axes_at(plan, 0.7)
    assert points.std(axis=0) == pytest.approx(0.4, rel=0.1)
    for level in (0.5, 0.9):
        patch = ellipse(points, level)
        inside = patch.get_patch_transform().inverted().transform(points)
        assert (np.hypot(*inside.T) <= 1).mean() == pytest.approx(level, abs=0.03)


def test_figures_are_drawn(plans):
    figures = [
        recess_sections({name: plans[0][name] for name in ("simulated Hannover", "printed absolute")}),
        risk_against_accuracy(
            risk_curve(planned(), [0.5, 1, 2, 3]),
            page.robot_points(page.error_rows(*plans)),
            planned().around.acceptable,
            0.2,
        ),
        access_figure(planned(), 5),
    ]
    assert all(isinstance(figure, Figure) for figure in figures)
    assert len(figures[0].axes) == 2
    with pytest.raises(InputError, match="plans"):
        recess_sections({})


def test_the_simulated_robots_drill_the_planned_hole():
    bone = specimen("TB14")
    plan = plan_access(bone.anatomy, settings=FEW, errors=NormalErrors(0.1, 0.1))
    holes = page.simulated_holes(plan, bone.fiducials, 3, 0)
    assert set(holes) == {"hannover", "vanderbilt"}
    for found in holes.values():
        assert found.values.shape[1:] == (2, 3)
        assert np.abs(found.values).max() < 3
