"""Other grids: extents stay, labels stay where they were."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real
from scipy.interpolate import RegularGridInterpolator
from volume_cases import random_affine, random_volume

from study.errors import GeometryError, InputError, LabelError
from study.volumes import LabelVolume, read_volume, reoriented, resampled

METHODS = ("smooth", "nearest", "majority")
SEEDS = st.integers(0, 2**32)


def outer_corners(volume):
    """mm of two opposite outer corners of the box the voxels fill."""
    return volume.points(np.array([[-0.5] * 3, np.array(volume.shape) - 0.5]))


def centres(volume):
    return np.argwhere(np.ones(volume.shape, bool))


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=25)
@given(seed=SEEDS)
def test_extent_stays_and_spacing_is_the_nearest_that_fits(method, seed):
    rng = np.random.default_rng(seed)
    volume = random_volume(rng)
    wanted = rng.uniform(0.2, 4, 3)
    other = resampled(volume, wanted, method)
    assert outer_corners(other) == pytest.approx(outer_corners(volume), abs=1e-9)
    assert other.directions == pytest.approx(volume.directions, abs=1e-12)
    extent = np.array(volume.shape) * volume.spacing
    assert (np.array(other.shape) == np.maximum(np.rint(extent / wanted), 1)).all()
    assert other.spacing * other.shape == pytest.approx(extent)
    assert other.names == volume.names
    assert set(np.unique(other.labels)) <= set(np.unique(volume.labels))


@pytest.mark.parametrize("method", METHODS)
@given(seed=SEEDS)
def test_same_spacing_changes_nothing(method, seed):
    volume = random_volume(np.random.default_rng(seed))
    same = resampled(volume, volume.spacing, method)
    assert (same.labels == volume.labels).all()
    assert same.affine == pytest.approx(volume.affine, abs=1e-12)


@given(seed=SEEDS, factor=st.sampled_from([2, 3, 4]))
def test_split_and_joined_again(seed, factor):
    volume = random_volume(np.random.default_rng(seed))
    for method in ("nearest", "majority"):
        fine = resampled(volume, volume.spacing / factor, method)
        repeated = volume.labels.repeat(factor, 0).repeat(factor, 1).repeat(factor, 2)
        assert (fine.labels == repeated).all()
    assert (resampled(fine, volume.spacing, "majority").labels == volume.labels).all()
    smooth = resampled(volume, volume.spacing / factor)
    if factor == 3:  # the middle one of three lies on the old centre
        assert (smooth.labels[1::3, 1::3, 1::3] == volume.labels).all()


@given(seed=SEEDS)
def test_nearest_is_the_voxel_that_holds_the_centre(seed):
    rng = np.random.default_rng(seed)
    volume = random_volume(rng)
    other = resampled(volume, rng.uniform(0.2, 4, 3), "nearest")
    place = volume.indices(other.points(centres(other)))
    inside = np.abs(place - np.floor(place) - 0.5).min(axis=1) > 1e-6  # not on a face
    held = volume.labels[tuple(np.rint(place).astype(int)[inside].T)]
    assert (other.labels.ravel()[inside] == held).all()


@settings(max_examples=20)
@given(seed=SEEDS)
def test_majority_fills_most_of_the_voxel(seed):
    rng = np.random.default_rng(seed)
    volume = random_volume(rng, (0, 1, 2))
    other = resampled(volume, rng.uniform(0.5, 6, 3), "majority")
    # Brute force: cut every old voxel at the new faces, by shares along each axis.
    weights = []
    for old, new in zip(volume.shape, other.shape, strict=True):
        edges = np.arange(new + 1) * old / new
        low = np.maximum(edges[:-1, None], np.arange(old))
        high = np.minimum(edges[1:, None], np.arange(old) + 1)
        weights.append(np.clip(high - low, 0, None) * new / old)
    values = np.unique(volume.labels)
    shares = np.stack([np.einsum("ia,jb,kc,abc->ijk", *weights, volume.labels == value) for value in values])
    assert shares.sum(axis=0) == pytest.approx(1)
    own = np.take_along_axis(shares, np.searchsorted(values, other.labels)[None], axis=0)[0]
    assert (own >= shares.max(axis=0) - 1e-4).all()


@settings(max_examples=20)
@given(seed=SEEDS)
def test_smooth_is_the_greatest_interpolated_share(seed):
    rng = np.random.default_rng(seed)
    volume = LabelVolume(rng.integers(0, 3, rng.integers(2, 7, 3)), random_affine(rng))
    other = resampled(volume, rng.uniform(0.2, 2, 3), "smooth")
    place = np.clip(volume.indices(other.points(centres(other))), 0, np.array(volume.shape) - 1)
    axes = [np.arange(size) for size in volume.shape]
    shares = np.stack(
        [RegularGridInterpolator(axes, (volume.labels == value).astype(float))(place) for value in range(3)]
    )
    own = np.take_along_axis(shares, other.labels.ravel()[None].astype(int), axis=0)[0]
    assert (own >= shares.max(axis=0) - 1e-4).all()


def test_ties_go_to_protected_bone_or_to_the_priority():
    names = {"air": 0, "protected": 1, "target": 2, "nerve": 9}

    def one(values, **options):
        volume = LabelVolume(np.array(values).reshape(-1, 1, 1), np.eye(4), names)
        spacing = (len(values), 1, 1)
        return [
            resampled(volume, spacing, method, **options).labels.item() for method in ("majority", "smooth")
        ]

    assert one([0, 1]) == one([1, 0]) == one([1, 2]) == one([2, 1]) == [1, 1]
    assert one([0, 2]) == one([2, 0]) == [2, 2]
    assert one([9, 1], priority=["nerve"]) == one([1, 9], priority=["nerve"]) == [9, 9]
    assert one([0, 2], priority=["nerve", "air"]) == [0, 0]
    with pytest.raises(LabelError):
        one([0, 1], priority=["dura"])


def test_smooth_rounds_what_nearest_leaves_in_steps():
    x, y, z = np.meshgrid(*[np.arange(24) - 11.5] * 3, indexing="ij")
    coarse = LabelVolume((np.sqrt(x**2 + y**2 + z**2) < 8).astype(np.uint8), np.eye(4), {"air": 0, "ball": 1})
    wrong = {}
    for method in ("smooth", "nearest"):
        fine = resampled(coarse, 0.25, method)
        points = fine.points(centres(fine)) - 11.5
        truth = np.linalg.norm(points, axis=1).reshape(fine.shape) < 8
        wrong[method] = (fine.mask("ball") != truth).sum()
    assert wrong["smooth"] < 0.8 * wrong["nearest"]


def test_bad_requests():
    volume = random_volume(np.random.default_rng(0))
    for spacing in (0, -1, np.nan, (1, 1, np.inf)):
        with pytest.raises(GeometryError, match="spacing: expected"):
            resampled(volume, spacing)
    with pytest.raises(InputError, match="method: expected"):
        resampled(volume, 1, "cubic")


@given(seed=SEEDS)
def test_reoriented_moves_no_voxel(seed):
    volume = random_volume(np.random.default_rng(seed), range(256))
    other = reoriented(volume)
    assert sorted(other.shape) == sorted(volume.shape)
    assert np.bincount(other.labels.ravel()).tolist() == np.bincount(volume.labels.ravel()).tolist()
    place = np.rint(volume.indices(other.points(centres(other)))).astype(int)
    assert volume.points(place) == pytest.approx(other.points(centres(other)), abs=1e-6)
    assert (volume.labels[tuple(place.T)] == other.labels.ravel()).all()
    assert other.names == volume.names
    again = reoriented(other)
    assert (again.affine == other.affine).all()


@given(seed=SEEDS)
def test_reoriented_axes_run_left_posterior_superior(seed):
    rng = np.random.default_rng(seed)
    permuted = np.eye(3)[:, rng.permutation(3)] * rng.choice([-1, 1], 3) * rng.uniform(0.2, 2, 3)
    tilted = permuted + rng.uniform(-0.05, 0.05, (3, 3)) * np.abs(permuted).max(axis=0)
    affine = np.eye(4)
    affine[:3, :3] = tilted
    directions = reoriented(LabelVolume(np.ones((2, 3, 4), np.uint8), affine)).directions
    assert (np.diag(directions) > 0.9).all()


def test_real_bone_halved_again():
    native = read_volume(real("temporal_bone/RT143/labels_native.nrrd"))
    half = resampled(native, native.spacing * 2, "majority")
    assert half.spacing == pytest.approx(native.spacing * 2, rel=0.01)
    for label in ("label_1", "label_13"):
        assert half.volume_mm3(label) == pytest.approx(native.volume_mm3(label), rel=0.05)
