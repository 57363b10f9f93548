"""Linear access to the cochlea: which line is planned, and how accurate a robot it needs."""

import json

import numpy as np
import pandas as pd
import pytest
from access_cases import FEW, planned, segment_distances, wall
from real_data import real
from scipy import stats

from study.errors import (
    GeometryError,
    GuidanceError,
    InputError,
    LabelError,
    PlanningError,
    TargetUnreachableError,
)
from study.guidance.access import (
    AccessSettings,
    NormalErrors,
    collision_probability,
    drill_axes,
    oval_window,
    plan_access,
    printed_lateral,
    required_std,
    risk_curve,
    rms_across,
    round_window_target,
    surroundings,
    to_image_axes,
)
from study.specimens import read_temporal_bone_case, specimen, structure_mask
from study.specimens.orientation import lateral_direction
from study.volumes import LabelVolume

# Targets and surroundings


def test_the_target_lies_on_the_labyrinth_right_below_the_oval_window():
    bone = specimen("CH01")
    window, target = oval_window(bone.anatomy), round_window_target(bone.anatomy)
    assert structure_mask(bone.anatomy, "labyrinth")[
        tuple(np.rint(bone.anatomy.indices(target[None])[0]).astype(int))
    ]
    assert target[2] <= window[2] - 2
    assert np.linalg.norm(target - window) < 4
    # The rule needs no label for the stapes.
    names, labels = dict(bone.anatomy.names), bone.anatomy.labels.copy()
    for name in ("malleus", "incus", "stapes"):
        labels[labels == names.pop(name)] = 30
    merged = LabelVolume(labels, bone.anatomy.affine, {**names, "ossicles": 30})
    assert (round_window_target(merged) == target).all()


def test_the_labyrinth_is_divided_and_shared_labels_are_one_structure():
    bone = specimen("TB14").anatomy
    around = surroundings(bone)
    whole = np.count_nonzero(structure_mask(bone, "labyrinth"))
    assert len(around.opening) + len(around.keep["labyrinth"]) == whole
    assert np.linalg.norm(around.opening - around.target, axis=1).max() <= 2
    names = dict(bone.names)
    labels = bone.labels.copy()
    labels[labels == names.pop("dura")] = names["sigmoid_sinus"]
    names["sinus_dura"] = names.pop("sigmoid_sinus")
    shared = surroundings(LabelVolume(labels, bone.affine, names))
    assert "sigmoid_sinus_and_dura" in shared.keep
    assert shared.acceptable["sigmoid_sinus_and_dura"] == 0.01
    assert around.missing == ("vestibular_aqueduct",)


def without(name):
    bone = specimen("TB14").anatomy
    labels = bone.labels.copy()
    labels[labels == bone.names[name]] = bone.names["bone"]
    return LabelVolume(labels, bone.affine, {k: v for k, v in bone.names.items() if k != name})


@pytest.mark.parametrize("name", ["facial_nerve", "labyrinth"])
def test_a_structure_that_is_needed_is_asked_for(name):
    with pytest.raises(LabelError, match=name):
        plan_access(without(name), target=round_window_target(specimen("TB14").anatomy), side="right")


def test_without_ossicles_a_target_has_to_be_given():
    bone = specimen("TB14").anatomy
    names = {k: v for k, v in bone.names.items() if k not in ("malleus", "incus", "stapes")}
    keep = np.isin(bone.labels, list(names.values()))
    bare = LabelVolume(np.where(keep, bone.labels, 0), bone.affine, names)
    with pytest.raises(LabelError, match="ossicles"):
        plan_access(bare)
    plan_access(bare, round_window_target(bone), FEW).verify()


def test_a_target_far_from_the_labyrinth_is_refused():
    with pytest.raises(GeometryError, match="target"):
        plan_access(specimen("TB14").anatomy, target=[0.0, 0.0, -20.0])


# Plans


def test_a_plan_passes_between_the_nerves_and_touches_nothing():
    plan = planned()
    plan.verify()
    offsets = []
    for name in ("facial_nerve", "chorda_tympani"):
        voxels = plan.anatomy.points(np.argwhere(structure_mask(plan.anatomy, name)))
        assert segment_distances(voxels, plan.entry, plan.target).min() > plan.settings.drill_radius
        nearest = voxels[np.argmin(segment_distances(voxels, plan.entry, plan.target))]
        along = (nearest - plan.entry) @ plan.direction
        assert 0 < along < plan.length_mm
        offsets.append(nearest - plan.entry - along * plan.direction)
    cosine = offsets[0] @ offsets[1] / np.linalg.norm(offsets[0]) / np.linalg.norm(offsets[1])
    assert cosine <= -0.5
    gap = sum(np.linalg.norm(offset) for offset in offsets)
    assert plan.recess_width == pytest.approx(gap - plan.anatomy.spacing.mean())


def test_the_drill_enters_where_the_bone_ends():
    plan = planned()
    bone = structure_mask(plan.anatomy, "bone")

    def is_bone(point):
        return bone[tuple(np.rint(plan.anatomy.indices(point[None])[0]).astype(int))]

    assert is_bone(plan.entry)
    assert not any(is_bone(plan.entry - step * plan.direction) for step in np.arange(0.3, 8, 0.1))
    assert (plan.entry - plan.target) @ lateral_direction(plan.side) > 10


def test_the_plan_is_that_of_least_simulated_damage_and_repeats_itself():
    plan = planned()
    simulated = plan.candidates["simulated_damage"].dropna()
    assert len(simulated) == FEW.simulated
    assert plan.expected_damage == pytest.approx(simulated.min())
    weights = {name: 1 / share for name, share in plan.around.acceptable.items()}
    assert plan.expected_damage == pytest.approx(
        sum(weights[name] * share for name, share in plan.risks.probabilities.items())
    )
    again = plan_access(specimen("TB14").anatomy, settings=FEW, errors=NormalErrors(0.15, 0.15))
    assert (again.entry == plan.entry).all()
    assert (again.risks.clearances == plan.risks.clearances).all()
    pd.testing.assert_frame_equal(again.candidates, plan.candidates)


def test_no_other_line_through_the_recess_does_much_less_damage():
    plan = planned("TB14", 0.4)
    free = plan.candidates[[f"{name}_mm" for name in plan.risks.names]].min(axis=1) > 0
    rows = plan.candidates[free].sample(25, random_state=0)
    drawn = plan.model.sample(FEW.samples, np.random.default_rng(0))
    for _, row in rows.iterrows():
        entry = row[["entry_x_mm", "entry_y_mm", "entry_z_mm"]].to_numpy(float)
        errors = to_image_axes(drawn, entry, plan.target)
        risks = collision_probability(plan.around.keep, entry, plan.target, errors, FEW.drill_radius)
        damage = sum(share / plan.around.acceptable[name] for name, share in risks.probabilities.items())
        assert damage >= 0.9 * plan.expected_damage


def test_a_mirrored_bone_has_the_mirrored_lines():
    bone = specimen("TB14").anatomy
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    other = LabelVolume(bone.labels, mirror @ bone.affine, bone.names)
    left = plan_access(other, settings=FEW, errors=NormalErrors(0.15, 0.15))
    assert (planned().side, left.side) == ("right", "left")
    same = ["posterior_deg", "superior_deg", "recess_width_mm", "facial_nerve_mm", "entry_y_mm"]
    coarse = [plan.candidates[same].iloc[:150].to_numpy() for plan in (planned(), left)]
    np.testing.assert_allclose(*coarse, atol=1e-9)


def test_a_drill_too_thick_is_told_what_is_in_its_way():
    with pytest.raises(TargetUnreachableError, match=r"facial_nerve blocks \d+ of them"):
        plan_access(specimen("TB14").anatomy, settings=AccessSettings(drill_diameter=6.0, samples=100))


def test_a_cone_that_misses_the_recess_says_so():
    with pytest.raises(TargetUnreachableError, match="between facial_nerve and chorda_tympani"):
        plan_access(specimen("TB14").anatomy, settings=AccessSettings(fan_deg=4.0, samples=100))


def test_what_is_not_acceptable_is_said_or_refused():
    bone = specimen("TB14").anatomy
    plan = plan_access(bone, settings=FEW)
    assert "facial_nerve" in plan.too_probable
    assert not plan.acceptable
    assert plan.table().loc["facial_nerve", "accepted"] == 0.001
    with pytest.raises(PlanningError, match="facial_nerve with"):
        plan_access(bone, settings=FEW, acceptable_only=True)
    better = plan_access(bone, settings=FEW, errors=NormalErrors(0.05, 0.05), acceptable_only=True)
    assert better.acceptable
    assert better.reached.risk == 1


def test_a_chorda_that_may_be_sacrificed_leaves_the_facial_nerve_more_room():
    bone, errors = specimen("TB14").anatomy, NormalErrors(0.4, 0.4)
    settings = AccessSettings(samples=1500, simulated=4, refined=2, sacrificed=("chorda_tympani",))
    kept = plan_access(bone, settings=FEW, errors=errors)
    given_up = plan_access(bone, settings=settings, errors=errors)
    assert given_up.expected_damage < kept.expected_damage
    assert given_up.clearances["facial_nerve"] > kept.clearances["facial_nerve"]
    assert "chorda_tympani" not in given_up.too_probable
    given_up.verify()


def test_whole_voxels_make_a_plan_more_cautious():
    bone, errors = specimen("CH01").anatomy, NormalErrors(0.05, 0.05)
    whole = plan_access(
        bone,
        settings=AccessSettings(samples=1500, simulated=4, refined=2, voxels="whole", drill_diameter=1.0),
        errors=errors,
    )
    whole.verify()
    centres = collision_probability(whole.around.keep, whole.entry, whole.target, whole.risks.errors, 0.5)
    assert (centres.planned > whole.risks.planned).all()


def test_other_errors_on_the_same_hole_and_an_array_is_used_as_it_is():
    plan = planned()
    array = printed_lateral("hannover").sample(300, 4)
    other = plan.with_errors(array)
    assert len(other.risks.errors) == 300
    np.testing.assert_allclose(other.risks.errors, to_image_axes(array, plan.entry, plan.target))
    assert (other.entry == plan.entry).all()
    for wrong in (None, "hannover", NormalErrors, np.zeros((3, 3))):
        with pytest.raises(InputError, match="errors"):
            plan.with_errors(wrong)


def test_a_thicker_drill_on_the_same_line_is_nearer_by_half_of_what_it_is_thicker():
    plan = planned()
    thick = plan.with_drill(2.0)
    np.testing.assert_allclose(plan.risks.clearances - thick.risks.clearances, 0.25, atol=1e-9)
    assert thick.risks.hits.sum() > plan.risks.hits.sum()
    with pytest.raises(InputError, match="drill_diameter"):
        plan.with_drill(-1.0)


def test_a_plan_opens_in_slicer_as_a_line(tmp_path):
    plan = planned()
    plan.to_markups(tmp_path / "hole.mrk.json")
    (line,) = json.loads((tmp_path / "hole.mrk.json").read_text())["markups"]
    assert (line["type"], line["coordinateSystem"]) == ("Line", "LPS")
    places = [point["position"] for point in line["controlPoints"]]
    np.testing.assert_array_equal(places, [plan.entry, plan.target])


def test_verification_notices_a_changed_plan():
    plan = planned()
    moved = type(plan)(**{**vars(plan), "entry": plan.entry + np.array([0, 2.0, 0])})
    with pytest.raises(GuidanceError, match="clearance"):
        moved.verify()


@pytest.mark.parametrize(
    "change",
    [
        {"drill_diameter": 0},
        {"opening": 3.0},
        {"fan_deg": 90},
        {"voxels": "corner"},
        {"samples": 0},
        {"acceptable": {"facial_nerve": 0.001}},
        {"acceptable": {"facial_nerve": 0.001, "labyrinth": 0.01, "spleen": 0.5}},
        {"acceptable": {"facial_nerve": 1.0, "labyrinth": 0.01}},
        {"sacrificed": ("facial_nerve",)},
        {"recess_angle_deg": 30},
    ],
)
def test_bad_settings_are_named(change):
    name = "below_oval_window" if "opening" in change else next(iter(change))
    with pytest.raises(InputError, match=name):
        AccessSettings(**change)


# How accurate


def test_the_required_accuracy_is_where_the_risk_crosses_the_probability():
    plan = planned("TB14", 0.4)
    found = required_std(plan, "facial_nerve", 0.01)
    assert found.estimate.risk <= 0.01
    beyond = risk_curve(plan, [1.01 * found.scale])["probability"].iloc[0]
    assert beyond > 0.01 - 2 / FEW.samples
    assert found.target_std == pytest.approx(found.scale * rms_across(plan.risks.errors, plan.direction)[1])
    assert found.target_std == pytest.approx(found.scale * 0.4, rel=0.05)


def test_the_required_accuracy_of_a_flat_wall_is_the_normal_quantile():
    plan = planned()
    # A wall beside the planned drill, everywhere at the same distance.
    axes = drill_axes(plan.entry, plan.target)
    flat = wall(0.0)[:, [1, 2, 0]] + [1.55, 0, 15]
    around = type(plan.around)(
        plan.target,
        {"wall": flat @ axes.T + plan.entry},
        {},
        plan.around.opening,
        {"wall": 0.01},
        (),
    )
    other = type(plan)(**{**vars(plan), "around": around})
    other = type(other)(**{**vars(other), "settings": AccessSettings(samples=20_000)})
    other = other.with_errors(NormalErrors((0.2, 0, 0), (0.2, 0, 0)))
    found = required_std(other, "wall", 0.01)
    assert 0.2 * found.scale == pytest.approx((1.55 - 0.75) / stats.norm.isf(0.01), rel=0.04)
    curve = risk_curve(other, [0, 0.5, 1, 2], ("wall",))
    assert curve["probability"].is_monotonic_increasing
    assert curve["probability"].iloc[0] == 0


def test_required_accuracy_refuses_what_so_many_errors_cannot_tell():
    with pytest.raises(InputError, match="probability"):
        required_std(planned(), probability=1e-5)
    with pytest.raises(LabelError, match="spleen"):
        required_std(planned(), "spleen")
    with pytest.raises(InputError, match="scales"):
        risk_curve(planned(), [-1.0])


# Real bones


@pytest.mark.parametrize("name", ["RT143", "LT143", "LT151"])
def test_real_bones_have_a_way_through_the_facial_recess(name):
    bone = read_temporal_bone_case(real(f"temporal_bone/{name}"))
    plan = plan_access(bone.anatomy, settings=FEW, errors=NormalErrors(0.1, 0.1))
    plan.verify()
    assert plan.side == bone.side
    # Baron, 2: about 2 mm between the nerves, the cochlea about 35 mm deep.
    assert 1.5 < plan.recess_width < 3.5
    assert 20 < plan.length_mm < 40
    assert plan.reached.risk == 1
    assert "sigmoid_sinus_and_dura" in plan.clearances
    # Behind the ear canal, and no steeper than the mastoid's surface is wide.
    canal = bone.anatomy.points(np.argwhere(structure_mask(bone.anatomy, "external_auditory_canal")))
    assert plan.entry[1] > canal[:, 1].mean()
