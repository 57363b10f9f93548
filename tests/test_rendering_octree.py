import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from planning_cases import small_cone

from study import rendering
from study.collision import Drill
from study.collision.octree import OctreeCheck
from study.errors import GeometryError, InputError
from study.rendering.octree import box_wires
from study.volumes import LabelVolume

APPROACH = np.array([1.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def half_milled():
    volume = small_cone()
    labels = volume.labels.copy()
    labels[:20][labels[:20] == 2] = 0
    return volume.with_labels(labels)


@pytest.fixture(scope="module")
def tested(half_milled):
    """Burr's centre, axes within 55 degrees, which are free."""
    position = half_milled.points(np.array([18, 16, 15]))
    a, b = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 9))
    axes = np.stack([-np.ones(81), a.ravel(), b.ravel()], axis=1)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    solid = ~half_milled.mask("air")
    free = OctreeCheck(solid, half_milled.spacing).free(half_milled.indices(position) * 0.4, axes)
    return position, axes, free


def picture(figure, path):
    assert isinstance(figure, Figure)
    figure.savefig(path, dpi=60)
    image = matplotlib.image.imread(path)[..., :3]
    assert image.std() > 0.03 and len(np.unique(image.round(2))) > 10
    return {text.get_text() for text in figure.findobj(matplotlib.text.Text)}


def test_wires_draw_each_edge_once_where_the_volume_is():
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    affine = np.eye(4)
    affine[:3, :3] = turn * [0.3, 0.5, 0.7]
    affine[:3, 3] = [10, -20, 30]
    volume = LabelVolume(np.ones((4, 4, 4), np.uint8), affine, {"air": 0, "protected": 1})
    mesh = box_wires(volume, np.array([[0.5, 0.5, 0.5, 2.0], [2.5, 0.5, 0.5, 2.0]]))
    assert (mesh.n_points, mesh.n_lines) == (12, 20)
    np.testing.assert_allclose(
        mesh.compute_cell_sizes()["Length"].sum(), 8 * 0.6 + 6 * 1.0 + 6 * 1.4, rtol=1e-5
    )
    np.testing.assert_allclose(mesh.points.mean(axis=0), volume.points(np.array([1.5, 0.5, 0.5])), rtol=1e-5)
    with pytest.raises(InputError, match="at least one"):
        box_wires(volume, np.empty((0, 4)))


def test_octree_pictures(half_milled, tmp_path):
    texts = picture(rendering.octree_levels(half_milled), tmp_path / "levels.png")
    assert {"box of 12.8 mm", "box of 0.8 mm", "protected bone"} <= texts
    assert any(text.endswith("mm") and text[0].isdigit() for text in texts)  # a scale bar
    texts = picture(rendering.whole_octree(half_milled, APPROACH), tmp_path / "whole.png")
    assert any(text.startswith("boxes a level, from the largest down: 1, ") for text in texts)
    texts = picture(rendering.octree_section(half_milled, approach=APPROACH), tmp_path / "section.png")
    assert {"voxel of the surface", "box of 1.6 mm", "mm"} <= texts


def test_shaft_pictures(half_milled, tested, tmp_path):
    position, axes, free = tested
    assert 10 < free.sum() < 71
    shafts = (position, axes[free][0], axes[~free][0])
    texts = picture(rendering.shaft_against_octree(half_milled, *shafts), tmp_path / "pair.png")
    assert "voxels in collision" in texts
    texts = picture(rendering.shaft_range(half_milled, *tested), tmp_path / "range.png")
    assert f"(c) 81 axes tested, {free.sum()} free" in texts


def test_pictures_that_would_lie_are_refused(half_milled, tested):
    position, axes, free = tested
    with pytest.raises(InputError, match="free_axis: expected a shaft free"):
        rendering.shaft_against_octree(half_milled, position, axes[~free][0], axes[~free][0])
    with pytest.raises(InputError, match="blocked_axis: expected a shaft in collision"):
        rendering.shaft_against_octree(half_milled, position, axes[free][0], axes[free][0])
    with pytest.raises(InputError, match="both kinds"):
        rendering.shaft_range(half_milled, position, axes[free], free[free])
    with pytest.raises(InputError, match="shapes"):
        rendering.shaft_range(half_milled, position, axes, free[1:])
    stretched = LabelVolume(half_milled.labels, np.diag([0.4, 0.4, 0.8, 1.0]), half_milled.names)
    with pytest.raises(GeometryError, match="cubic"):
        rendering.shaft_range(stretched, position, axes, free, Drill())
