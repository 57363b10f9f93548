"""Every figure of chapter 4 that is seen in space is drawn, of a kidney whose grid is not the body's."""

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure
from real_data import real
from small_kidney import loose, small_kidney

from study.experiments.kidney_chapter import removal_settings
from study.margins import grow_margin
from study.margins.removal_steps import removal_step, typical_protrusion
from study.registration import RobotError
from study.rendering.kidney import (
    case_figure,
    inside_figure,
    kidney_view,
    margins_on_kidney,
    protrusion_figure,
    removal_growth_figure,
    violation_figure,
)
from study.specimens import load_kidney

SEED = 2


@pytest.fixture(scope="module")
def grown():
    settings = replace(removal_settings(150, "published"), least_transfer=20, initial_transfer=0.3)
    volume = small_kidney().anatomy
    return grow_margin(volume, "tumour", loose(), 0.05, settings=settings, rng=SEED, purpose="remove")


@pytest.fixture(scope="module")
def step(grown):
    return removal_step(grown, 0.4, SEED)


@pytest.fixture(scope="module")
def inside():
    case = small_kidney()
    model = RobotError(case.tumour_centre, 0.4, 0.01)
    settings = removal_settings(300)
    return grow_margin(case.anatomy, "tumour", model, 0.05, settings=settings, rng=1, purpose="stay_inside")


def protrusion(grown, step, model):
    shown = typical_protrusion(grown.volume, grown.structure_mask, step.before, model, 40, 0)
    return protrusion_figure(small_kidney(), grown, step.before, shown)


FIGURES = {
    "case": lambda g, s, i: case_figure(small_kidney()),
    "4.2": lambda g, s, i: protrusion(g, s, loose()),
    "4.2 no hit": lambda g, s, i: protrusion(g, s, RobotError((0, 0, 0))),
    "4.3": lambda g, s, i: violation_figure(small_kidney(), g, s),
    "4.4": lambda g, s, i: removal_growth_figure(small_kidney(), g, s),
    "4.6": lambda g, s, i: margins_on_kidney(
        small_kidney(), {"grown": g, "none": replace(g, mask=np.zeros_like(g.mask))}
    ),
    "inside": lambda g, s, i: inside_figure(small_kidney(), i),
    "nothing inside": lambda g, s, i: inside_figure(small_kidney(), replace(i, mask=i.structure_mask)),
}


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_drawn(name, grown, step, inside, tmp_path):
    figure = FIGURES[name](grown, step, inside)
    assert isinstance(figure, Figure)
    figure.savefig(tmp_path / "figure.png", dpi=50)
    image = matplotlib.image.imread(tmp_path / "figure.png")[..., :3]
    assert image.std() > 0.03 and len(np.unique(image.round(2))) > 10


def test_shell_is_drawn_around_the_margin_of_its_step(grown, step):
    """What the margin became later is not in the picture."""
    pictures = []
    for mask in (grown.mask, np.zeros_like(grown.mask)):
        figure = violation_figure(small_kidney(), replace(grown, mask=mask), step)
        pictures.append([axes.images[0].get_array() for axes in figure.axes if axes.images])
    for one, other in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, other)


def test_camera_stands_on_the_tumours_side():
    case = small_kidney()
    kidney = case.anatomy.points(np.argwhere(case.anatomy.mask("kidney"))).mean(axis=0)
    view = kidney_view(case)
    assert view.looking @ (case.tumour_centre - kidney) < 0
    assert view.looking[1] > 0  # from the front, where the swab is


def test_real_kidney_is_drawn(tmp_path):
    figure = case_figure(load_kidney(real("kidney/case_00091")))
    figure.savefig(tmp_path / "figure.png", dpi=50)
    assert matplotlib.image.imread(tmp_path / "figure.png")[..., :3].std() > 0.03
