"""Plans on small volumes: complete, safe, repeatable, in any orientation."""

import json

import numpy as np
import pytest
import pyvista as pv
from planning_cases import cone_volume, small_cone
from real_data import real

from study.collision import Drill
from study.errors import (
    FileFormatError,
    GeometryError,
    IncompletePlanWarning,
    InputError,
    PlanningError,
    PlanViolation,
    TargetUnreachableError,
)
from study.planners import (
    FitnessTerm,
    FitnessWeights,
    Plan,
    PlannerSettings,
    fitness_score,
    plan_passes,
    plan_path,
)
from study.volumes import PLANNING_NAMES, LabelVolume, read_volume

STRATEGIES = ("3d", "zigzag")


@pytest.fixture(scope="module", params=STRATEGIES)
def plan(request):
    return plan_path(cone_volume(), request.param)


def test_plan_clears_the_accessible_target_and_verifies(plan):
    assert plan.left.sum() <= 0.001 * plan.accessible.sum()
    replay = plan.verify()
    assert replay["removed_mm3"] == pytest.approx(
        plan.volume.volume_mm3("target") - plan.remaining.volume_mm3("target")
    )
    # What is left is what this burr cannot get at, and the ridges the supervoxel clears without the
    # burr's centre having been there.
    left = plan.remaining.mask("target")
    assert (left & ~plan.modified.unreachable).sum() <= 0.01 * plan.volume.mask("target").sum()


def test_plan_keeps_to_one_voxel_steps_and_ends_where_it_began(plan):
    diagonal = np.linalg.norm(plan.volume.spacing)
    assert plan.step_lengths.max() <= diagonal * (1 + 1e-9)
    assert np.allclose(plan.points[0], plan.points[-1])
    assert np.allclose(np.linalg.norm(plan.axes, axis=1), 1)
    tilt = np.rad2deg(np.arccos(np.clip(plan.axes @ -plan.approach, -1, 1)))
    assert tilt.max() <= plan.settings.max_tilt_deg + 1e-9
    across = plan.volume.directions[:, plan.rotation_axis]
    assert np.abs(plan.axes @ across).max() < 1e-12


def test_summary_has_the_columns_of_the_tables(plan):
    summary = plan.summary()
    assert summary["predicted_path_length_mm"] == pytest.approx(plan.length_mm)
    assert summary["modified_initial_target_cm3"] == pytest.approx(plan.accessible.sum() * 0.064 / 1000)
    assert 0 < summary["steps_in_contact_over_path_length_ratio"] < 1
    moved = plan.step_lengths > 0
    contacts = summary["steps_in_contact_over_path_length_ratio"] * moved.sum()
    volume = contacts * summary["average_voxels_per_step_in_contact_voxels"] * plan.volume.voxel_volume
    assert volume == pytest.approx(plan.removed[1:].sum())


def test_same_seed_same_bytes(plan, tmp_path):
    again = plan_path(plan.volume, plan.strategy)
    plan.to_csv(tmp_path / "a.csv")
    again.to_csv(tmp_path / "b.csv")
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert np.array_equal(plan.remaining.labels, again.remaining.labels)


def test_plan_survives_its_file(plan, tmp_path):
    plan.to_csv(tmp_path / "plan.csv")
    back = Plan.read_csv(tmp_path / "plan.csv", plan.volume)
    assert np.array_equal(back.points, plan.points) and np.array_equal(back.axes, plan.axes)
    back.verify()
    with pytest.raises(InputError, match="without its volume"):
        Plan.read_csv(tmp_path / "plan.csv").verify()


def test_exports_open_in_other_programs(plan, tmp_path):
    plan.to_markups(tmp_path / "path.mrk.json")
    markup = json.loads((tmp_path / "path.mrk.json").read_text())["markups"][0]
    positions = np.array([point["position"] for point in markup["controlPoints"]])
    assert markup["coordinateSystem"] == "LPS"
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).sum() == pytest.approx(plan.length_mm)
    assert len(positions) < len(plan.points)
    plan.to_polyline(tmp_path / "path.vtp")
    line = pv.read(tmp_path / "path.vtp")
    assert line.n_lines == 1
    assert np.allclose(line.points, plan.points, atol=1e-4)
    assert line["removed_mm3"].sum() == pytest.approx(plan.removed.sum(), rel=1e-5)


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_left_and_right_and_every_grid_axis_give_the_same_path(strategy):
    volume = small_cone()
    settings = PlannerSettings(rotation_axis=2)
    first = plan_path(volume, strategy, settings=settings)
    mirrored = volume.with_labels(volume.labels[::-1].copy())
    other = plan_path(mirrored, strategy, settings=settings)
    last = (volume.shape[0] - 1) * 0.4
    assert np.allclose(first.approach, [1, 0, 0]) and np.allclose(other.approach, [-1, 0, 0])
    assert np.allclose(other.points * [-1, 1, 1] + [last, 0, 0], first.points)
    assert np.allclose(other.axes * [-1, 1, 1], first.axes)
    # drilled along j, tilting about i: (i, j, k) -> (j, k, i)
    turned = LabelVolume(
        np.moveaxis(volume.labels, [0, 1, 2], [1, 2, 0]), np.diag([0.4, 0.4, 0.4, 1]), volume.names
    )
    third = plan_path(turned, strategy, settings=PlannerSettings(rotation_axis=0))
    assert np.allclose(third.points[:, [1, 2, 0]], first.points)


def test_oblique_volume_gives_the_rotated_path():
    volume = small_cone()
    c, s = np.cos(0.4), np.sin(0.4)
    affine = np.eye(4)
    affine[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.diag([0.4, 0.4, 0.4])
    affine[:3, 3] = [7, -3, 11]
    oblique = plan_path(LabelVolume(volume.labels, affine, volume.names))
    straight = plan_path(volume)
    assert np.allclose(oblique.volume.indices(oblique.points), straight.volume.indices(straight.points))
    assert np.allclose(oblique.axes @ oblique.volume.directions, straight.axes)
    oblique.verify()


def test_zigzag_rows_lie_as_far_apart_as_the_3d_planner_steps():
    default = plan_path(small_cone(), "zigzag")
    three = plan_path(small_cone(), "zigzag", settings=PlannerSettings(row_pitch=3, layer_pitch=3))
    two = plan_path(small_cone(), "zigzag", settings=PlannerSettings(row_pitch=2, layer_pitch=2))
    assert np.array_equal(default.points, three.points)
    assert two.length_mm > three.length_mm


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_a_larger_scan_changes_nothing(strategy):
    volume = small_cone(shape=(42, 32, 30), air=8.8)  # air enough for the burr to stay in the image
    sides = np.array([[0, 1], [1, 1], [1, 1]], bool)
    larger = volume.padded(20.0, "protected", sides).padded(
        60.0, "air", np.array([[1, 0], [0, 0], [0, 0]], bool)
    )
    settings = PlannerSettings(rotation_axis=1)
    assert np.array_equal(
        np.round(plan_path(larger, strategy, settings=settings).points, 9),
        np.round(plan_path(volume, strategy, settings=settings).points, 9),
    )


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_anisotropic_voxels_are_planned_on_and_verify(strategy):
    volume = cone_volume(shape=(38, 46, 30), spacing=(0.45, 0.38, 0.6), depth=7.0, top=7.0)
    plan = plan_path(volume, strategy)
    plan.verify()
    assert plan.left.sum() <= 0.001 * plan.accessible.sum()


@pytest.mark.parametrize("strategy", STRATEGIES)
def test_undercut_target_is_milled_as_far_as_the_shaft_reaches(strategy):
    volume = cone_volume(shape=(50, 60, 56), depth=13.0, top=6.0, opening=0.0, undercut=3.5)
    plan = plan_path(volume, strategy)
    plan.verify()
    walled_off = plan.modified.target & ~plan.accessible
    assert walled_off.any()  # the overhang hides some of it from any tilt
    assert plan.accessible.sum() > 0.5 * plan.modified.target.sum()


def test_more_tilt_reaches_no_less():
    volume = cone_volume(shape=(50, 60, 56), depth=13.0, top=6.0, opening=0.0, undercut=3.5)
    counts = [
        plan_path(volume, settings=PlannerSettings(max_tilt_deg=tilt, rotation_axis=2)).accessible.sum()
        for tilt in (5, 20, 45)
    ]
    assert counts[0] < counts[1] < counts[2]


@pytest.mark.parametrize("depth", [0.3, 0.5, 1.0, 1.4])
def test_any_supervoxel_size_clears_the_target(depth):
    plan = plan_path(small_cone(), settings=PlannerSettings(cutting_depth=depth))
    plan.verify()
    assert plan.left.sum() == 0


def test_a_26_connected_boundary_holds_the_6_connected_one_and_is_cleared():
    faces = plan_path(small_cone())
    vertices = plan_path(small_cone(), settings=PlannerSettings(boundary_connectivity=26))
    assert (vertices.modified.boundary >= faces.modified.boundary).all()
    assert vertices.modified.boundary.sum() > faces.modified.boundary.sum()
    vertices.verify()
    assert vertices.left.sum() == 0


def test_a_user_term_changes_the_path_as_asked():
    volume = cone_volume()
    depth = np.broadcast_to(np.arange(volume.shape[0])[:, None, None] / volume.shape[0], volume.shape)

    @fitness_score
    def sideways_last(here, there, layer_mm, rise_mm, lateral_mm):
        return 1.0 - there

    def mean_depth_of_first_half(plan):
        done = np.cumsum(plan.removed)
        half = done < done[-1] / 2
        return float(
            np.average(plan.volume.indices(plan.points)[half, 0], weights=plan.removed[half] + 1e-12)
        )

    plain = plan_path(volume)
    shallow_first = plan_path(
        volume, settings=PlannerSettings(terms=(FitnessTerm("shallow first", 30.0, depth, sideways_last),))
    )
    shallow_first.verify()
    assert mean_depth_of_first_half(shallow_first) < mean_depth_of_first_half(plain)
    as_function = PlannerSettings(terms=(FitnessTerm("same", 30.0, lambda v: depth, sideways_last),))
    assert np.array_equal(plan_path(volume, settings=as_function).points, shallow_first.points)
    with pytest.raises(InputError, match="finite field of shape"):
        plan_path(volume, settings=PlannerSettings(terms=(FitnessTerm("bad", 1.0, depth[1:]),)))


def test_pits_apart_on_flat_bone_are_both_milled():
    labels = np.zeros((70, 90, 40), np.uint8)
    labels[40:] = 1
    labels[40:52, 10:30, 10:30] = labels[40:52, 60:80, 10:30] = 2
    volume = LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), PLANNING_NAMES)
    for strategy in STRATEGIES:
        plan = plan_path(volume, strategy, approach=[1, 0, 0])
        plan.verify()
        assert plan.left.sum() == 0


def test_target_that_cannot_be_reached_is_warned_of():
    labels = np.zeros((46, 90, 40), np.uint8)
    labels[16:] = 1
    labels[16:28, 10:30, 10:30] = labels[16:28, 60:78, 12:30] = 2
    labels[:, 40:50] = 1  # a wall up to the image's edge
    volume = LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), PLANNING_NAMES)
    with pytest.warns(IncompletePlanWarning, match="leaves"):
        plan = plan_path(volume, approach=[1, 0, 0])
    plan.verify()
    assert 0.3 < plan.left_fraction < 0.5  # it took the larger pit


@pytest.mark.parametrize(
    "thresholds", [{"min_overlap_deg": 5.0}, {"min_window_deg": 1.0, "min_overlap_deg": 1.0, "seed": 4}]
)
def test_a_burr_that_trapped_itself_backs_out(thresholds):
    volume = read_volume(real("temporal_bone/LT143/planning_0p38.nrrd"))
    plan = plan_path(volume, settings=PlannerSettings(**thresholds))
    plan.verify()
    assert plan.left_fraction <= 0.001


def test_a_finishing_plan_can_be_read_back(tmp_path):
    last = plan_passes(cone_volume(shape=(40, 44, 40), depth=8.0, top=7.0), [5.0, 3.0])[-1]
    last.to_csv(tmp_path / "pass.csv")
    Plan.read_csv(tmp_path / "pass.csv", last.volume, drill=last.drill).verify()


def test_passes_go_from_large_to_small_and_leave_less():
    volume = cone_volume(shape=(40, 44, 40), depth=8.0, top=7.0)
    plans = plan_passes(volume, [3.0, 5.0])
    assert [plan.drill.burr_diameter for plan in plans] == [5.0, 3.0]
    for plan in plans:
        plan.verify()
    assert plans[1].remaining.volume_mm3("target") < plans[0].remaining.volume_mm3("target")
    assert np.array_equal(plans[1].volume.labels, plans[0].remaining.labels)
    with pytest.raises(InputError, match="different"):
        plan_passes(volume, [5.0, 5.0])


def changed(plan, **fields):
    values = {name: getattr(plan, name) for name in plan.__dataclass_fields__} | fields
    return Plan(**values)


def test_verify_catches_what_a_wrong_plan_does():
    plan = plan_path(small_cone())
    middle = len(plan.points) // 2
    points = plan.points.copy()
    points[middle:] += [3.0, 0, 0]
    with pytest.raises(PlanViolation, match="protected"):
        changed(plan, points=points).verify()
    removed = plan.removed.copy()
    removed[np.argmax(removed)] -= 0.064
    with pytest.raises(PlanViolation, match="the plan says"):
        changed(plan, removed=removed).verify()
    axes = np.tile([0.05, -0.99874922, 0.0], (len(plan.points), 1))
    with pytest.raises(PlanViolation, match="shaft"):
        changed(plan, axes=axes).verify()
    with pytest.raises(PlanViolation, match="remaining"):
        changed(plan, remaining=plan.volume).verify()
    with pytest.raises(PlanViolation, match="unit"):
        changed(plan, axes=plan.axes * 2).verify()
    far = plan.points.copy()
    far[:] += [0, 40, 0]
    with pytest.raises(PlanViolation):
        changed(plan, points=far).verify()


def test_verify_sweeps_between_points():
    """Two safe poses with bone between them: only the sweep can see it."""
    labels = np.zeros((60, 30, 30), np.uint8)
    labels[30:32, :, :] = 1
    labels[10, 15, 15] = 2
    volume = LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1.0]), PLANNING_NAMES)
    from study.planners import modified_volume

    points = np.array([[10, 15, 15], [50, 15, 15]]) * 0.4
    plan = Plan(
        points, np.tile([-1.0, 0, 0], (2, 1)), np.array([0.064, 0.0]), modified=modified_volume(volume, 2.5)
    )
    with pytest.raises(PlanViolation, match="protected"):
        plan.verify()


def test_bad_requests_are_refused():
    volume = small_cone()
    for arguments, error in [
        ({"strategy": "spiral"}, InputError),
        ({"dof": 6}, InputError),
        ({"approach": [0, 0, 0]}, InputError),
        ({"approach": [np.nan, 0, 0]}, InputError),
        ({"approach": "left"}, InputError),
        ({"approach": [1, 0]}, InputError),
        ({"settings": PlannerSettings(cutting_depth=8.0)}, InputError),
        ({"settings": PlannerSettings(rotation_axis=0)}, InputError),
    ]:
        with pytest.raises(error):
            plan_path(volume, **arguments)
    for settings in [
        {"cutting_depth": 0},
        {"max_tilt_deg": 90},
        {"min_window_deg": -1},
        {"min_overlap_deg": 9},
        {"row_pitch": -1},
        {"seed": -1},
        {"boundary_connectivity": 18},
        {"seed": 1.5},
        {"row_pitch": 2.5},
        {"weights": FitnessWeights(direction=float("nan"))},
    ]:
        with pytest.raises(InputError, match=next(iter(settings))):
            PlannerSettings(**settings)


def test_buried_target_and_sheared_grid_are_refused():
    volume = cone_volume(shape=(50, 60, 56), depth=13.0, top=6.0, opening=0.0)
    labels = volume.labels.copy()
    labels[labels == 0] = 1
    with pytest.raises(TargetUnreachableError, match="outside air"):
        plan_path(volume.with_labels(labels))
    lid = volume.labels.copy()
    lid[12] = 1
    with pytest.raises(PlanningError):
        plan_path(volume.with_labels(lid), approach=[1, 0, 0])
    affine = np.diag([0.4, 0.4, 0.4, 1.0])
    affine[0, 1] = 0.1
    with pytest.raises(GeometryError, match="right angles"):
        plan_path(LabelVolume(volume.labels, affine, volume.names))


def test_a_file_that_is_no_plan_is_refused(tmp_path):
    path = tmp_path / "plan.csv"
    path.write_text("x_mm,y_mm\n1,2\n")
    with pytest.raises(FileFormatError, match="missing z_mm"):
        Plan.read_csv(path)


@pytest.mark.parametrize("strategy", STRATEGIES)
@pytest.mark.parametrize("case", ["RT143", "LT143"])
def test_real_bones_are_planned_completely_and_safely(case, strategy):
    volume = read_volume(real(f"temporal_bone/{case}/planning_0p38.nrrd"))
    plan = plan_path(volume, strategy, drill=Drill())
    plan.verify()
    assert plan.left.sum() <= 0.001 * plan.accessible.sum()
    assert plan.accessible.sum() >= 0.99 * plan.modified.target.sum()
    lateral = 1 if case.startswith("RT") else -1
    assert np.allclose(plan.approach, [lateral, 0, 0])
