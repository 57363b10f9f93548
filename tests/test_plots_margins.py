"""What the figures of chapter 3 show is what the margins are made of; and every figure is drawn."""

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure

from study.cases import Case
from study.errors import InputError
from study.experiments.margin_survey import grow_margins, survey_table
from study.margins import ACCEPTABLE_RISKS, GrowthSettings, grow_margin, reduced_target
from study.margins.illustration import (
    analyzed_shell,
    growth_step,
    hit_corners,
    shell_corners,
    telling_voxel,
    typical_damage,
)
from study.margins.point_risk import point_damage_risk
from study.plots.margin_charts import method_charts
from study.plots.margins import reduced_target_sections, risk_against_margin, transfer_figure
from study.plots.planes import Plane, axial, coronal, look_up
from study.plots.registration_error import error_map, plane_through, two_distances
from study.registration import PointRegistration
from study.rendering.board import emptiest_corner
from study.rendering.labelled import labelled_anatomy, pixels, visible_spots
from study.rendering.margins import growth_figure, landing_figure, margins_in_space, shell_risks
from study.rendering.views import View
from study.volumes import LabelVolume

APPROACH = np.array([1.0, 0.0, 0.0])
NAMES = {"air": 0, "bone": 1, "facial_nerve": 2, "sigmoid_sinus": 3}
QUICK = GrowthSettings(registrations=400, validation_registrations=200, confidence=None)


@pytest.fixture(scope="module")
def block():
    """A block of bone under air with a bent nerve and a sinus, and its planning volume."""
    labels = np.ones((34, 40, 36), np.uint8)
    labels[:6] = 0
    i, j, k = np.indices(labels.shape)
    labels[np.hypot(i - 20 - 0.15 * (k - 18), j - 16) < 2.6] = 2
    labels[np.hypot(i - 18, j - 33) < 4] = 3
    affine = np.diag([0.3, 0.3, 0.3, 1.0])
    affine[:3, 3] = [-4, 7, 11]
    anatomy = LabelVolume(labels, affine, NAMES)
    target = (labels == 1) & (np.hypot(j - 22, k - 18) < 10) & (i < 24)
    planning = np.where(labels == 0, 0, np.where(target, 2, 1)).astype(np.uint8)
    return anatomy, LabelVolume(planning, affine, {"air": 0, "protected": 1, "target": 2})


@pytest.fixture(scope="module")
def model():
    ring = [[-22, 30, 16], [-24, 16, 38], [-20, -6, 30], [-23, -14, 6], [-21, 8, -8], [-25, 28, -4]]
    return PointRegistration(np.array(ring, float), fle_rms=0.4)


@pytest.fixture(scope="module")
def margins(block, model):
    return [
        grow_margin(block[0], name, model, risk, settings=QUICK, rng=1)
        for name, risk in (("facial_nerve", 0.02), ("sigmoid_sinus", 0.05))
    ]


@pytest.fixture(scope="module")
def grown(block, model):
    settings = GrowthSettings(
        method="published", registrations=300, validation_registrations=100, initial_transfer=0.06
    )
    return grow_margin(block[0], "facial_nerve", model, 0.02, settings=settings, rng=2)


# What is shown of a margin


def test_shell_corners_are_the_mixed_corners_of_the_lattice(block):
    anatomy, _ = block
    union = anatomy.mask("sigmoid_sinus")  # it is cut by two faces of the volume
    found = {tuple(c) for c in np.rint(anatomy.indices(shell_corners(anatomy, union)) + 0.5).astype(int)}
    expected = set()
    for corner in np.ndindex(*(n + 1 for n in anatomy.shape)):
        box = tuple(slice(max(c - 1, 0), min(c + 1, n)) for c, n in zip(corner, anatomy.shape, strict=True))
        if union[box].any() and not union[box].all():
            expected.add(corner)
    assert found == expected


def test_share_of_hits_in_plain_python_is_the_risk_of_the_kernels(margins, model):
    margin = margins[0]
    transforms = model.sample(400, np.random.default_rng(5))
    corners = shell_corners(margin.volume, margin.structure_mask | margin.mask)
    hits = sum(
        hit_corners(margin.volume, margin.structure_mask, corners, transform).any()
        for transform in transforms
    )

    class Drawn:
        def sample(self, n, rng):
            return transforms[:n]

        def moments(self):
            return model.moments()

    assert hits == margin.risk_on(400, 0, Drawn()).hits


def test_typical_damage_is_one_of_the_harmful_registrations(block, grown, model):
    step = growth_step(grown, 0.4)
    landing = typical_damage(block[0], grown.structure_mask, step.before, model, 60, rng=3)
    assert 0 < landing.hits < landing.registrations == 60
    assert 0 < landing.hit.sum() < len(landing.hit)
    again = hit_corners(block[0], grown.structure_mask, landing.corners, landing.transform)
    np.testing.assert_array_equal(again, landing.hit)
    # a margin as wide as the volume cannot be damaged: then the largest motion is shown
    everywhere = ~grown.structure_mask
    everywhere[:2] = False
    assert not typical_damage(block[0], grown.structure_mask, everywhere, model, 20, rng=3).hit.any()


def test_steps_gone_through_again_end_in_the_margin_that_was_grown(grown):
    history = grown.history
    number = len(history) - 2
    last = growth_step(grown, float(history["risk"].iloc[number]))
    assert last.number <= number  # the first of equals
    if last.number == number:
        np.testing.assert_array_equal(last.after, grown.mask)
    for risk in (1.0, 0.3):
        step = growth_step(grown, risk)
        row = history.iloc[step.number]
        assert step.before.sum() == row["margin_voxels"] and step.shell.sum() == row["shell_voxels"]
        assert step.after.sum() == history["margin_voxels"].iloc[step.number + 1]
        assert not (step.chosen & ~step.shell).any()
        assert not (step.after & ~grown.mask).any()


def test_steps_need_a_history(margins):
    with pytest.raises(InputError, match="grown in steps"):
        growth_step(margins[0], 0.5)
    with pytest.raises(InputError, match="grown in steps"):
        transfer_figure(margins[0])


def test_analyzed_shell_holds_the_final_shell_with_the_same_risks(margins):
    margin = margins[0]
    voxels, risks = analyzed_shell(margin)
    of = {tuple(voxel): risk for voxel, risk in zip(voxels.tolist(), risks, strict=True)}
    mine = [of[tuple(voxel)] for voxel in margin.final_shell.tolist()]
    np.testing.assert_allclose(mine, margin.shell_point_risks, rtol=1e-6)


def test_nearest_points_are_nearest_in_their_own_sense(margins):
    nearest = telling_voxel(margins[0])
    surface = shell_corners(margins[0].volume, margins[0].structure_mask)
    assert nearest.millimetres(nearest.euclidean) == pytest.approx(
        min(nearest.millimetres(point) for point in surface)
    )
    smallest = min(nearest.deviations(point) for point in surface)
    assert nearest.deviations(nearest.mahalanobis) == pytest.approx(smallest)
    assert nearest.deviations(nearest.euclidean) >= smallest
    voxel = np.rint(margins[0].volume.indices(nearest.voxel[None])[0]).astype(int)
    row = np.flatnonzero((margins[0].final_shell == voxel).all(axis=1))
    assert margins[0].shell_point_risks[row] == pytest.approx(point_damage_risk(smallest), rel=1e-6)


def test_survey_states_what_it_skips_and_why(block, model):
    anatomy, planning = block
    labels = anatomy.labels.copy()
    labels[10:12, 4:6, 4] = 4
    anatomy = anatomy.with_labels(labels, {**NAMES, "chorda_tympani": 4})
    case = Case("block", planning, anatomy, APPROACH, model.fiducials)
    settings = GrowthSettings(registrations=4000, validation_registrations=500)
    grown, skipped = grow_margins(case, anatomy, model, settings, rng=4)
    assert [margin.structure for margin in grown] == ["facial_nerve", "sigmoid_sinus"]
    assert skipped["chorda_tympani"].startswith("too small: 4 voxels") and "10" in skipped["chorda_tympani"]
    assert skipped["internal_auditory_canal"].startswith("absent")
    table = survey_table(grown, skipped)
    assert set(table.index) == set(ACCEPTABLE_RISKS)
    row = table.loc["facial_nerve"]
    assert row["margin_mm3"] == pytest.approx(row["margin_voxels"] * 0.027)
    assert row["in_sample_risk"] <= row["acceptable_risk"]
    assert row["validated_low"] <= row["validated_risk"] <= row["validated_high"]
    assert table.loc["sigmoid_sinus", "edge_share"] > 0  # it ends at the edge of the volume
    assert np.isnan(table.loc["chorda_tympani", "margin_mm3"])


# Planes and places


@pytest.mark.parametrize("build", [axial, coronal])
def test_plane_places_points_where_it_samples_them(block, build):
    anatomy, _ = block
    centre = anatomy.points(np.array([[16.0, 20, 18]]))[0]
    plane = build(centre, APPROACH, 3.0, 2.0, 60)
    flat = plane.place(plane.points.reshape(-1, 3))
    assert np.abs(flat[:, 2]).max() < 1e-9
    assert np.abs(flat[:, 0]).max() < 3.0 and np.abs(flat[:, 1]).max() < 2.0
    assert flat[1, 0] > flat[0, 0] and flat[-1, 1] > flat[0, 1]
    index = np.floor(anatomy.indices(plane.points.reshape(-1, 3)) + 0.5).astype(int)
    values = plane.of(anatomy, anatomy.labels)
    np.testing.assert_array_equal(values.ravel(), anatomy.labels[tuple(index.T)])
    assert look_up(anatomy, anatomy.labels, np.array([[1e4, 0, 0]])) == 0
    assert plane.down @ APPROACH == pytest.approx(1)


def test_plane_refuses_skewed_axes():
    with pytest.raises(InputError, match="perpendicular"):
        Plane(np.zeros(3), np.array([1.0, 0, 0]), np.array([0.8, 0.6, 0]), 1, 1)
    with pytest.raises(InputError, match="approach"):
        axial(np.zeros(3), np.array([0.0, 1.0, 0.0]), 1.0)


def test_oblique_plane_holds_both_nearest_points(margins):
    nearest = telling_voxel(margins[0])
    plane = plane_through(nearest, APPROACH, 1.0)
    place = plane.place(np.stack([nearest.voxel, nearest.euclidean, nearest.mahalanobis]))
    assert np.abs(place[:, 2]).max() < 1e-9


def test_names_point_at_what_is_seen():
    view = View([1.0, 0, 0], [0.0, 0, 1.0], np.zeros(3), 10.0)
    grid = np.stack(np.meshgrid(0, np.arange(-3, 3.1, 0.2), np.arange(-3, 3.1, 0.2)), -1).reshape(-1, 3)
    front, behind = (grid + np.array([depth, 2.0, 0.0]) for depth in (0.0, 5.0))
    spots = visible_spots({"facial_nerve": front, "dura": behind}, {}, view, (400, 400))
    assert set(spots) == {"facial_nerve"}
    np.testing.assert_allclose(
        spots["facial_nerve"], pixels(np.array([[0, 2, 0.0]]), view, (400, 400))[0], atol=8
    )
    image = np.full((50, 50, 3), 255, np.uint8)
    image[30:, 30:] = 0
    image[:10, 40:] = 0
    assert emptiest_corner(image) == (False, False)


# Figures

FIGURES = {
    "3.1": lambda a, p, ms, g, m: labelled_anatomy(a, p, APPROACH),
    "3.2": lambda a, p, ms, g, m: reduced_target_sections(p, ms, reduced_target(p, ms), APPROACH),
    "3.2 nothing taken": lambda a, p, ms, g, m: reduced_target_sections(p, ms, p, APPROACH),
    "3.3": lambda a, p, ms, g, m: method_charts(),
    "3.4": lambda a, p, ms, g, m: landing_figure(
        g, growth_step(g, 0.5),
        typical_damage(a, g.structure_mask, growth_step(g, 0.5).before, m, 40, 0), APPROACH,
    ),
    "3.4 no hit": lambda a, p, ms, g, m: landing_figure(
        g, growth_step(g, 0.5), typical_damage(a, g.structure_mask, g.mask, m, 1, 0), APPROACH
    ),
    "3.5": lambda a, p, ms, g, m: two_distances(ms[0], telling_voxel(ms[0]), APPROACH),
    "3.6": lambda a, p, ms, g, m: shell_risks(ms[:1], ["(a) shell"], APPROACH),
    "3.7": lambda a, p, ms, g, m: growth_figure(g, growth_step(g, 0.5), APPROACH),
    "3.8": lambda a, p, ms, g, m: transfer_figure(g),
    "3.9": lambda a, p, ms, g, m: margins_in_space(a, p, ms, m.fiducials, APPROACH),
    "risk curves": lambda a, p, ms, g, m: risk_against_margin(ms),
    "error map": lambda a, p, ms, g, m: error_map(m, a, p, APPROACH),
}  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_drawn(name, block, margins, grown, model, tmp_path):
    figure = FIGURES[name](*block, margins, grown, model)
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "figure.png", dpi=50)
    image = matplotlib.image.imread(tmp_path / "figure.png")[..., :3]
    assert image.std() > 0.03 and len(np.unique(image.round(2))) > 10
