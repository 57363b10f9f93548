"""LabelVolume: what it accepts, what it says, where its voxels are."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from volume_cases import random_affine, random_volume

from study.errors import GeometryError, InputError, LabelError
from study.volumes import PLANNING_NAMES, LabelVolume
from study.volumes.label_volume import default_names

CUBE = np.zeros((2, 3, 4), np.uint8)


def bad_affine(row, column, value):
    affine = np.eye(4)
    affine[row, column] = value
    return affine


@pytest.mark.parametrize(
    ("labels", "says"),
    [
        (np.zeros((2, 2), np.uint8), "(2, 2)"),
        (np.zeros((2, 0, 2), np.uint8), "(2, 0, 2)"),
        (np.zeros((2, 2, 2, 1), np.uint8), "(2, 2, 2, 1)"),
        (np.zeros((2, 2, 2)), "float64"),
        (np.full((2, 2, 2), 256), "256"),
        (np.full((2, 2, 2), -1), "-1"),
    ],
)
def test_refuses_what_is_no_label_map(labels, says):
    with pytest.raises(InputError, match="labels: expected") as caught:
        LabelVolume(labels, np.eye(4))
    assert says in str(caught.value)


@pytest.mark.parametrize(
    "affine",
    [
        np.eye(3),
        bad_affine(0, 0, np.nan),
        bad_affine(1, 3, np.inf),
        bad_affine(1, 1, 0),
        bad_affine(3, 0, 1),
        bad_affine(3, 3, 2),
        np.array([[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
    ],
)
def test_refuses_an_affine_that_cannot_be_used(affine):
    with pytest.raises(GeometryError, match="affine: expected"):
        LabelVolume(CUBE, affine)


@pytest.mark.parametrize("names", [{"a": 256}, {"a": -1}, {3: 1}])
def test_refuses_bad_names(names):
    with pytest.raises(InputError, match="names: expected"):
        LabelVolume(CUBE, np.eye(4), names)


def test_stores_uint8_and_cannot_be_changed():
    volume = LabelVolume(np.full((2, 2, 2), 7, np.int64), np.eye(4))
    assert volume.labels.dtype == np.uint8
    with pytest.raises(ValueError, match="read-only"):
        volume.labels[0, 0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        volume.affine[0, 0] = 2
    assert LabelVolume(np.ones((1, 1, 1), bool), np.eye(4)).mask("protected").all()


def test_default_names():
    assert default_names([0, 2]) == PLANNING_NAMES == {"air": 0, "protected": 1, "target": 2}
    assert default_names([]) == PLANNING_NAMES
    assert default_names([3, 0]) == {"label_0": 0, "label_3": 3}
    assert LabelVolume(CUBE + 5, np.eye(4)).names == {"label_5": 5}


def test_masks_and_volumes():
    labels = CUBE.copy()
    labels[0, 0] = [1, 1, 2, 3]
    volume = LabelVolume(labels, np.diag([0.5, 2, 3, 1]), {"air": 0, "a": 1, "b": 2, "c": 3})
    assert volume.mask("a").sum() == 2
    assert volume.mask("a", "c").sum() == 3
    assert volume.voxel_volume == pytest.approx(3)
    assert volume.volume_mm3("a", "b") == pytest.approx(9)
    for names in (["nerve"], ["a", "nerve"], []):
        with pytest.raises(LabelError, match="expected labels among"):
            volume.mask(*names)


@given(seed=st.integers(0, 2**32))
def test_points_and_indices_are_inverse(seed):
    rng = np.random.default_rng(seed)
    volume = random_volume(rng)
    indices = rng.uniform(-5, 15, (20, 3))
    points = volume.points(indices)
    assert volume.indices(points) == pytest.approx(indices, abs=1e-8)
    homogeneous = np.c_[indices, np.ones(20)]
    assert points == pytest.approx((volume.affine @ homogeneous.T).T[:, :3], abs=1e-9)
    assert volume.directions * volume.spacing == pytest.approx(volume.affine[:3, :3], abs=1e-12)


@given(seed=st.integers(0, 2**32), mm=st.floats(0, 4))
def test_padding_leaves_every_voxel_where_it_was(seed, mm):
    rng = np.random.default_rng(seed)
    volume = random_volume(rng)
    sides = rng.random((3, 2)) < 0.5
    padded = volume.padded(mm, "last", sides)
    before = np.argwhere(np.ones(volume.shape, bool))
    after = np.rint(padded.indices(volume.points(before))).astype(int)
    assert padded.points(after) == pytest.approx(volume.points(before), abs=1e-8)
    assert (padded.labels[tuple(after.T)] == volume.labels[tuple(before.T)]).all()
    added = (np.array(padded.shape) - volume.shape) * volume.spacing
    count = sides.sum(axis=1)
    assert (added >= count * mm - 1e-6).all()
    assert (added < count * (mm + volume.spacing) + 1e-6).all()
    new = np.ones(padded.shape, bool)
    new[tuple(after.T)] = False
    assert (padded.labels[new] == 255).all()


def test_padding_refuses():
    volume = LabelVolume(CUBE, np.eye(4))
    with pytest.raises(LabelError):
        volume.padded(1, "bone")
    for mm in (-1, np.nan):
        with pytest.raises(InputError, match="mm: expected"):
            volume.padded(mm)


def test_other_labels_on_the_same_grid():
    volume = LabelVolume(CUBE, random_affine(np.random.default_rng(1)))
    other = volume.with_labels(CUBE + 2)
    assert other.mask("target").all()
    assert (other.affine == volume.affine).all()
    assert volume.with_labels(CUBE, {"bone": 0}).names == {"bone": 0}
    with pytest.raises(InputError, match=r"expected shape \(2, 3, 4\)"):
        volume.with_labels(CUBE[:1])


def test_labels_cannot_change_behind_the_volume():
    labels = np.zeros((2, 3, 4), np.uint8)
    volume = LabelVolume(labels, np.eye(4))
    labels[:] = 1
    assert not volume.labels.any()
    with pytest.raises(ValueError, match="read-only"):
        volume.labels[0, 0, 0] = 1


def test_fractional_label_values_and_scalar_points_are_refused():
    with pytest.raises(InputError, match="names"):
        LabelVolume(np.zeros((2, 2, 2), np.uint8), np.eye(4), {"a": 1.7})
    volume = LabelVolume(np.zeros((2, 2, 2), np.uint8), np.eye(4))
    for call in (volume.points, volume.indices):
        with pytest.raises(InputError, match="shape"):
            call(5.0)
