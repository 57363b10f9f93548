"""What margins leave of the target, on the margins' own grid and on any other."""

from types import SimpleNamespace

import numpy as np
import pytest
from margin_cases import affine_of, blobs

from study.errors import LabelError
from study.margins import GrowthSettings, grow_margin, reduced_target
from study.registration import PointRegistration
from study.volumes import LabelVolume

PLANNING = {"air": 0, "protected": 1, "target": 2}


def planning_of(shape, affine, seed=0):
    return LabelVolume(np.random.default_rng(seed).integers(0, 3, shape).astype(np.uint8), affine, PLANNING)


def margin_on(shape, affine, seed=1, share=0.1):
    """What `reduced_target` reads of a margin."""
    mask = blobs(shape, share, seed)
    structure = mask & (np.random.default_rng(seed).random(shape) < 0.5)
    return SimpleNamespace(
        structure="nerve",
        mask=mask & ~structure,
        structure_mask=structure,
        volume=LabelVolume(structure.astype(np.uint8), affine, {"air": 0, "nerve": 1}),
    )


def spared(planning, margins):
    reduced = reduced_target(planning, margins)
    assert reduced.names == planning.names and np.array_equal(reduced.affine, planning.affine)
    changed = reduced.labels != planning.labels
    assert (planning.labels[changed] == 2).all() and (reduced.labels[changed] == 1).all()
    return changed


def test_on_the_same_grid_the_target_loses_margin_and_structure():
    affine = affine_of((0.4, 0.3, 0.5), (0.1, 0.2, 0.3), (1, 2, 3))
    planning = planning_of((13, 12, 11), affine)
    margins = [margin_on((13, 12, 11), affine, seed) for seed in (1, 2)]
    taken = np.any([margin.mask | margin.structure_mask for margin in margins], axis=0)
    assert np.array_equal(spared(planning, margins), taken & planning.mask("target"))
    assert not spared(planning, []).any()


@pytest.mark.parametrize("ratio, shift", [(2, 0), (3, 1), (2, 1), (1, 1), (1, 3)])
def test_on_shifted_and_finer_grids_by_counting_what_lies_inside(ratio, shift):
    # Whole numbers of quarter voxels: which interval overlaps which is integer arithmetic.
    planning = planning_of((10, 9, 8), affine_of((0.4, 0.4, 0.4)))
    step = 0.4 / ratio
    fine = margin_on(
        (8 * ratio, 7 * ratio, 6 * ratio), affine_of((step,) * 3, origin=np.full(3, shift * 0.1)), 3
    )
    union = fine.mask | fine.structure_mask
    expected = np.zeros(planning.shape, bool)
    for voxel in np.argwhere(union):
        low = np.rint(12 * (fine.volume.points(voxel[None] - 0.5)[0] / 0.4 + 0.5)).astype(int)
        high = np.rint(12 * (fine.volume.points(voxel[None] + 0.5)[0] / 0.4 + 0.5)).astype(int)
        first, last = np.maximum(low // 12, 0), np.maximum(-(-high // 12), 0)
        expected[tuple(slice(a, b) for a, b in zip(first, last, strict=True))] = True
    assert np.array_equal(spared(planning, [fine]), expected & planning.mask("target"))


@pytest.mark.parametrize("spacing", [(0.2, 0.2, 0.2), (0.4, 0.4, 0.4), (0.43, 0.43, 0.43), (0.9, 0.3, 0.5)])
@pytest.mark.parametrize("turn", [(0, 0, 0), (0.3, 0, 0), (0.5, -0.4, 0.8)])
def test_on_turned_grids_no_point_of_a_margin_is_left_in_the_target(spacing, turn):
    planning = planning_of((12, 12, 12), affine_of((0.4, 0.4, 0.4), (0, 0.2, 0), (1, 1, 1)))
    shape = tuple(np.ceil(4.8 / np.array(spacing)).astype(int))
    other = margin_on(shape, affine_of(spacing, turn, (1.13, 0.97, 1.2)), 4)
    found = spared(planning, [other])
    # Many points in every voxel of the margin: none may lie in what is left of the target.
    voxels = np.argwhere(other.mask | other.structure_mask)
    grid = np.stack(np.meshgrid(*[np.linspace(-0.4999, 0.4999, 13)] * 3, indexing="ij"), -1).reshape(-1, 3)
    held = np.zeros(planning.shape, bool)
    for offset in grid:
        index = np.rint(planning.indices(other.volume.points(voxels + offset))).astype(int)
        index = index[((index >= 0) & (index < planning.shape)).all(axis=1)]
        held[tuple(index.T)] = True
    target = planning.mask("target")
    assert not (held & target & ~found).any()
    # And hardly more is taken: slivers between the points only.
    assert np.count_nonzero(found & ~held) <= 0.03 * found.sum() + 2


def test_margins_elsewhere_take_nothing():
    planning = planning_of((8, 8, 8), affine_of())
    assert not spared(planning, [margin_on((8, 8, 8), affine_of(origin=(50, 0, 0)))]).any()
    touching = margin_on((8, 8, 8), affine_of(origin=(3.2, 0, 0)))  # side by side
    assert not spared(planning, [touching]).any()


def test_grown_margins_protect_what_they_surround():
    labels = np.ones((20, 20, 20), np.uint8)
    labels[8:12, 8:12, 3:17] = 3
    anatomy = LabelVolume(labels, affine_of(), {"air": 0, "bone": 1, "nerve": 3})
    planning = LabelVolume(np.where(labels == 3, 1, 2), affine_of(), PLANNING)
    model = PointRegistration([[0, 0, 0], [20, 0, 0], [0, 20, 0], [0, 0, 20]], 0.2)
    settings = GrowthSettings(registrations=500, validation_registrations=0)
    margin = grow_margin(anatomy, "nerve", model, 0.05, settings=settings, rng=0)
    reduced = reduced_target(planning, [margin])
    assert np.array_equal(reduced.mask("target"), planning.mask("target") & ~margin.mask)
    assert reduced.volume_mm3("target") == pytest.approx(planning.volume_mm3("target") - margin.volume_mm3)


def test_a_planning_volume_is_needed():
    anatomy = LabelVolume(np.ones((4, 4, 4), np.uint8), affine_of(), {"air": 0, "bone": 1})
    with pytest.raises(LabelError, match=r"target and protected, got \['air', 'bone'\]"):
        reduced_target(anatomy, [])
