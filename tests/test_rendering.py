import json
import os
import subprocess
import sys

import matplotlib
import numpy as np
import pytest
import pyvista as pv
from matplotlib.figure import Figure
from planning_cases import small_cone
from real_data import real

from study import plots, rendering
from study.cases import distance_from, load_case, parse_approach
from study.collision import Drill
from study.errors import InputError, PlanViolation
from study.experiments.sensitivity import removal_order_near, vary
from study.planners import PlannerSettings, plan_path
from study.planners.moments import moment, rows_on_one_plane, telling_row
from study.plots.boundary import REMOVED, TARGET
from study.specimens.structures import SYNONYMS
from study.volumes import LabelVolume, write_volume

APPROACH = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def plan():
    return plan_path(small_cone(), approach=APPROACH)


@pytest.fixture(scope="module")
def middle(plan):
    return moment(plan, len(plan.points) // 3)


@pytest.fixture
def closed_plotters(monkeypatch):
    """Every plotter made during the test, to be asked whether it was closed."""
    made = []

    class Counted(pv.Plotter):
        def __init__(self, *args, **kwargs):
            super().__init__(*args, **kwargs)
            made.append(self)

    monkeypatch.setattr(pv, "Plotter", Counted)
    return made


def is_picture(figure, path):
    figure.savefig(path, dpi=60)
    image = matplotlib.image.imread(path)[..., :3]
    return isinstance(figure, Figure) and image.std() > 0.03 and len(np.unique(image.round(2))) > 10


# Surfaces


def test_surface_lies_where_the_voxels_are_on_an_oblique_grid():
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    affine = np.eye(4)
    affine[:3, :3] = turn * [0.3, 0.5, 0.7]
    affine[:3, 3] = [10, -20, 30]
    mask = np.zeros((20, 22, 24), bool)
    mask[4:15, 6:17, 5:20] = True
    volume = LabelVolume(mask.astype(np.uint8), affine, {"air": 0, "bone": 1})
    centre = volume.points(np.argwhere(mask)).mean(axis=0)
    exact = rendering.mask_surface_exact(mask, affine)
    np.testing.assert_allclose(exact.triangulate().volume, mask.sum() * volume.voxel_volume, rtol=1e-4)
    np.testing.assert_allclose(exact.points.mean(axis=0), centre, atol=1e-3)
    smooth = rendering.mask_surface(mask, affine)
    assert smooth.is_manifold
    np.testing.assert_allclose(smooth.center_of_mass(), centre, atol=0.05)
    assert 0.85 < smooth.volume / (mask.sum() * volume.voxel_volume) < 1.0


@pytest.mark.parametrize("flip", [1.0, -1.0])
def test_normals_point_outward_also_on_a_mirrored_grid(flip):
    mask = np.zeros((12, 12, 12), bool)
    mask[3:9, 3:9, 3:9] = True
    mesh = rendering.mask_surface(mask, np.diag([flip, 1.0, 1.0, 1.0]))
    outward = mesh.points - mesh.points.mean(axis=0)
    assert (np.einsum("ij,ij->i", outward, mesh.point_data.active_normals) > 0).all()


def test_thin_structures_survive_and_empty_masks_are_refused():
    mask = np.zeros((9, 9, 30), bool)
    mask[4, 4, 3:27] = True
    length = np.ptp(rendering.mask_surface(mask, np.eye(4)).points[:, 2])
    assert length > 20
    with pytest.raises(InputError, match="at least one voxel"):
        rendering.mask_surface(np.zeros((3, 3, 3), bool), np.eye(4))


def test_mask_at_the_edge_is_closed():
    assert rendering.mask_surface(np.ones((5, 6, 7), bool), np.eye(4)).is_manifold


# Views and scenes


def test_surgeons_view_has_superior_up_and_compass_letters():
    right_ear = rendering.approach_view([1.0, 0.0, 0.0])
    np.testing.assert_allclose(right_ear.up, [0, 0, 1])
    np.testing.assert_allclose(
        right_ear.right, [0, -1, 0]
    )  # looking from the right, the face is to the right
    assert {letters[:2] for letters in right_ear.compass()} == {("A", "P"), ("I", "S")}
    turned = right_ear.turned(30, 20)
    np.testing.assert_allclose(
        [turned.looking @ turned.up, np.linalg.norm(turned.looking)], [0, 1], atol=1e-12
    )


def test_scene_fills_the_picture_and_its_plotter_is_closed(closed_plotters):
    scene = rendering.Scene(rendering.approach_view(APPROACH)).label(small_cone(), "target")
    image = scene.image((240, 180))
    assert image.shape == (180, 240, 3)
    drawn = (image < 250).any(axis=2)
    assert drawn.any(axis=1).mean() > 0.8 or drawn.any(axis=0).mean() > 0.8
    assert not drawn[:2].any() and not drawn[:, :2].any()
    assert len(closed_plotters) == 1 and closed_plotters[0]._closed


def test_plotter_is_closed_after_an_error(closed_plotters):
    with pytest.raises(ZeroDivisionError), rendering.off_screen((60, 60)):
        raise ZeroDivisionError
    assert closed_plotters[0]._closed


def test_show_is_a_picture_in_batch_and_writes_it(tmp_path, plan, monkeypatch):
    monkeypatch.setenv("STUDY_BATCH", "1")
    image = rendering.show(rendering.plan_scene(plan), tmp_path / "plan.png", size=(200, 150))
    assert image.size == (200, 150) and np.asarray(image).std() > 5
    assert [p.name for p in tmp_path.iterdir()] == ["plan.png"]


def test_pictures_need_no_display(tmp_path):
    code = (
        "from planning_cases import small_cone; from study import rendering as r;"
        "r.show(r.Scene(r.approach_view([1, 0, 0])).label(small_cone(), 'target'), 'a.png', size=(80, 60))"
    )
    quiet = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY")}
    quiet["PYTHONPATH"] = os.path.dirname(__file__)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=quiet, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "a.png").stat().st_size > 500
    assert "X server" not in done.stderr


# Milling frames


def test_frames_follow_the_plan_to_what_remains(plan):
    frames = rendering.milling_frames(plan, 4)
    start = plan.volume.volume_mm3("target")
    for frame in frames:
        np.testing.assert_allclose(start - frame.remaining.volume_mm3("target"), frame.removed_mm3)
        np.testing.assert_allclose(frame.position, plan.points[frame.row])
    shares = [frame.removed_mm3 / plan.removed.sum() for frame in frames]
    assert (np.diff(shares) > 0).all() and shares[-1] == pytest.approx(1)
    assert np.all(np.array(shares) >= np.arange(1, 5) / 4 - 1e-9)
    np.testing.assert_array_equal(frames[-1].remaining.mask("target"), plan.remaining.mask("target"))


def test_frames_of_an_edited_plan_are_refused(plan):
    from dataclasses import replace

    removed = plan.removed.copy()
    removed[np.flatnonzero(removed)[3]] += 5.0
    with pytest.raises(PlanViolation):
        rendering.milling_frames(replace(plan, removed=removed), 2)


# Moments


def test_moment_holds_both_simulations_in_step(plan, middle):
    assert len(plan.points) // 3 <= middle.row
    np.testing.assert_allclose(middle.position, plan.points[middle.row])
    np.testing.assert_allclose(middle.axis, plan.axes[middle.row], atol=1e-9)
    removed = plan.volume.volume_mm3("target") - middle.unmodified.volume_mm3("target")
    np.testing.assert_allclose(removed, plan.removed[: middle.row + 1].sum())
    assert middle.window[0] <= middle.tilt <= middle.window[1]
    labels = middle.modified
    offsets = np.argwhere(np.ones(2 * middle.reach + 1)) - middle.reach
    inside = labels.labels[tuple((middle.index + offsets).T)]
    assert not (inside == labels.names["target"]).any()  # the supervoxel cleared what it holds


def test_last_moment_is_the_end_and_candidates_are_near_targets(plan, middle):
    last = moment(plan, -1)
    home = last.unmodified.mask("target") & ~plan.remaining.mask("target")  # the way home may cut a little
    assert home.sum() * plan.volume.voxel_volume == pytest.approx(plan.removed[last.row + 1 :].sum())
    assert not (plan.remaining.mask("target") & ~last.unmodified.mask("target")).any()
    assert not plan.left.any() and not len(last.candidates)
    points = np.concatenate([middle.candidates, middle.inaccessible])
    at = np.rint(middle.modified.indices(points)).astype(int)
    assert (np.abs(at - middle.index) <= middle.reach + 1).all()
    assert np.isin(middle.modified.labels[tuple(at.T)], (2, 3)).all()
    assert len(middle.scores) == len(middle.candidates)


def test_next_point_of_the_plan_is_towards_the_best_reached_candidate(plan):
    here = moment(plan, 0)
    best = here.candidates[np.argmax(here.scores)]
    row = here.row + 1
    arrived = moment(plan, row)
    np.testing.assert_allclose(arrived.position, best)


def test_moment_refuses_other_plans(plan):
    zigzag = plan_path(plan.volume, strategy="zigzag", drill=plan.drill, approach=APPROACH)
    with pytest.raises(InputError, match="zigzag"):
        moment(zigzag, 0)
    with pytest.raises(InputError, match="row"):
        moment(plan, len(plan.points))


def test_rows_of_interest(plan):
    tilt = plan.axes @ -plan.approach
    assert tilt[telling_row(plan)] == pytest.approx(tilt.min(), abs=1e-3)
    rows = rows_on_one_plane(plan, 3)
    assert len(rows) == 3 and rows == sorted(rows)
    assert np.ptp(plan.volume.indices(plan.points[rows])[:, plan.rotation_axis]) < 1e-6


# The figures of chapter 2

FIGURES = {
    "2.1": lambda p, m: rendering.segmentation(p.volume, p.approach),
    "2.2": lambda p, m: plots.burr_and_voxels(),
    "2.3": lambda p, m: plots.modified_steps(p.modified, p.approach),
    "2.4": lambda p, m: plots.dilation_into_air(p.modified, p.approach),
    "2.5": lambda p, m: rendering.modified_segmentation(p.modified, p.approach),
    "2.6": lambda p, m: rendering.drill_figure(p.drill),
    "2.7": lambda p, m: plots.slab_collapse(m, p),
    "2.10": lambda p, m: rendering.supervoxel(m),
    "2.13a": lambda p, m: plots.short_path_plane(),
    "2.13b": lambda p, m: rendering.short_path_in_space(),
    "2.14": lambda p, m: plots.flow_chart(),
    "2.15": lambda p, m: plots.accessible_window(m, p.drill),
    "2.17": lambda p, m: rendering.candidates(m),
    "2.18": lambda p, m: plots.simulations_in_step(p, [m]),
    "2.19": lambda p, m: rendering.path_in_region(p),
    "milling": lambda p, m: rendering.milling_strip(p, 2),
    "anatomy": lambda p, m: rendering.anatomy(_anatomy(p.volume), p.volume, p.approach),
}


def _anatomy(planning):
    labels = planning.labels.copy()
    labels[planning.mask("target")] = 1
    labels[-6:-3, 10:20, 10:20] = 3
    return planning.with_labels(labels, {"air": 0, "bone": 1, "facial_nerve": 3})


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_drawn(name, plan, middle, tmp_path, closed_plotters):
    figure = FIGURES[name](plan, middle)
    assert is_picture(figure, tmp_path / "figure.png")
    assert all(plotter._closed for plotter in closed_plotters)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_axes_of_plane_figures_are_in_mm(plan, middle):
    for name in ("2.2", "2.3", "2.4", "2.7", "2.13a", "2.15", "2.18"):
        figure = FIGURES[name](plan, middle)
        assert any(ax.get_xlabel() == "mm" for ax in figure.axes), name


def test_section_turns_outside_up():
    volume = small_cone()
    plane = plots.section(volume, APPROACH)
    shown = plane.of(volume.labels)
    assert (shown[0] == 0).all() and (shown[-1] != 0).all()
    mirrored = volume.with_labels(volume.labels[::-1])
    other = plots.section(mirrored, -APPROACH)
    np.testing.assert_array_equal(other.of(mirrored.labels), shown)
    here = np.array([12, 9, other.index if other.normal == 2 else 7])
    assert other.place(here)[1] == pytest.approx((mirrored.shape[0] - 1 - 12 - other.box[0][0]) * 0.4)


# The two-dimensional examples are computed


def test_boundary_is_what_keeps_a_band_from_staying():
    without = plots.mill_plane(plots.pocket(), boundary=False)
    with_boundary = plots.mill_plane(plots.pocket(), boundary=True)
    for milled in (without, with_boundary):
        assert not np.isin(milled.modified_end, (2, 3)).any()
        assert (np.abs(np.diff(milled.path, axis=0)).sum(axis=1) == 1).all()
        changed = milled.unmodified_end != milled.segmented
        assert (milled.segmented[changed] == TARGET).all()
        assert (milled.unmodified_end[changed] == REMOVED).all()
    assert without.left > 0
    assert with_boundary.left == 0
    assert len(with_boundary.path) > len(without.path)


def test_descending_path_backs_out_of_dead_ends():
    blocked = np.zeros((4, 4), bool)
    blocked[1, 1] = blocked[2, 0] = True  # from (0, 0) downwards it is a dead end
    labels = plots.manhattan_labels(blocked, (0, 0), (3, 3))
    assert labels[3, 3] == 0 and labels[0, 0] == 6 and labels[1, 1] == -1
    for seed in range(6):
        path = plots.descending_path(labels, (0, 0), seed)
        assert [labels[at] for at in path] == [6, 5, 4, 3, 2, 1, 0]
    blocked[0, 1] = True
    assert plots.descending_path(plots.manhattan_labels(blocked, (0, 0), (3, 3)), (0, 0)) is None


# Palette


def test_every_structure_has_its_own_colour_and_public_names_are_known():
    names = [name for name in SYNONYMS if name != "air"]
    colours = [plots.colour_of(name) for name in names]
    assert len(set(colours)) == len(colours)
    assert plots.style_of("EAC") == plots.STYLES["external_auditory_canal"]
    assert plots.style_of("Sinus_Dura").title == "sigmoid sinus and dura"
    assert plots.style_of("Some nucleus").title == "Some nucleus"


# Cases and sensitivity


def test_case_from_a_file_is_taken_as_it_is(tmp_path):
    write_volume(small_cone(), tmp_path / "mine.seg.nrrd")
    case = load_case(tmp_path / "mine.seg.nrrd")
    assert case.name == "mine" and case.anatomy is None
    np.testing.assert_array_equal(case.planning.mask("target"), small_cone().mask("target"))
    name, mask = case.most_delicate()
    assert name == "protected bone" and mask.sum() == small_cone().mask("protected").sum()


def test_case_names_what_it_expected(tmp_path):
    with pytest.raises(InputError, match="CH01 to TB17"):
        load_case("CH99")
    strange = LabelVolume(np.full((4, 4, 4), 30, np.uint8), np.eye(4), {"thing": 30})
    write_volume(strange, tmp_path / "strange.nrrd")
    with pytest.raises(InputError, match="thing"):
        load_case(tmp_path / "strange.nrrd")


@pytest.mark.parametrize("path", ["temporal_bone/LT151", "temporal_bone/LT151/labels_0p38.nrrd"])
def test_real_bone_is_a_case(path):
    case = load_case(real(path))
    assert case.planning.mask("target").any()
    assert case.most_delicate()[0] == "facial nerve"


def test_approach_parameter():
    assert parse_approach("") is None
    np.testing.assert_array_equal(parse_approach("1, 0 -2"), [1, 0, -2])
    for wrong in ("1 2", "left", "0 0 0"):
        with pytest.raises(InputError, match="approach"):
            parse_approach(wrong)


def test_distance_field():
    mask = np.zeros((9, 3, 3), bool)
    mask[0, 1, 1] = True
    field = distance_from(mask, np.array([2.0, 1.0, 1.0]), 10.0)
    np.testing.assert_allclose(field[:, 1, 1], [0, 0.2, 0.4, 0.6, 0.8, 1, 1, 1, 1])


def test_sensitivity_table_and_failed_variant():
    table = vary(
        small_cone(),
        {"first": {}, "wide windows": {"max_tilt_deg": 10.0, "min_window_deg": 20.0, "min_overlap_deg": 20.0},
         "zigzag": {"strategy": "zigzag", "row_pitch": 2}},
        drill=Drill(), settings=PlannerSettings(), approach=APPROACH,
    )  # fmt: skip
    assert table.loc["first", "length_over_first_ratio"] == 1
    assert table.loc["zigzag", "length_over_first_ratio"] != 1
    assert list(table.index) == ["first", "wide windows", "zigzag"]


def test_removal_order_counts_what_went_before(plan):
    assert removal_order_near(plan, plan.volume.mask("protected"), 1.0) == pytest.approx(0.5)
    deep = np.zeros(plan.volume.shape, bool)
    deep[-2] = True
    shallow = np.zeros(plan.volume.shape, bool)
    shallow[0] = True
    assert removal_order_near(plan, deep, 0.1) > 0.5 > removal_order_near(plan, shallow, 0.1)
    with pytest.raises(InputError, match="share"):
        removal_order_near(plan, deep, 0.0)


def test_notebook_declares_its_parameters():
    from study.paths import PROJECT

    notebook = json.loads((PROJECT / "notebooks" / "plan_one_specimen.ipynb").read_text())
    tagged = [c for c in notebook["cells"] if "parameters" in c["metadata"].get("tags", [])]
    assert len(tagged) == 1 and 'specimen = "TB03"' in "".join(tagged[0]["source"])
