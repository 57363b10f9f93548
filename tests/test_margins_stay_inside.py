"""Regions to stay in: against brute force, and against needles that are aimed at them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from margin_cases import Shifts, affine_of, around, blobs, shell, volume_of
from removal_cases import SHAPES, drawn, landing_voxels, looked_up, turning
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from study.errors import InputError, MarginError
from study.margins import GrowthSettings, allowed_hits, grow_margin
from study.registration import RobotError

FEW = GrowthSettings(registrations=300, validation_registrations=200, violation_registrations=250)
ALLOWED = allowed_hits(300, 0.05, 0.95)


def cases():
    oblique = affine_of((0.5, 0.8, 0.6), (0.7, -0.3, 2.1), (-80, 33, 410), (1, 2, 0), (-1, 1, 1))
    ball = volume_of(shell((25, 21, 23), (12, 10, 11), 0, 9.3), oblique)
    yield "ball, oblique and flipped", ball, turning(ball, 0.4, 0.02)
    mirrored = volume_of(blobs((18, 19, 17), 0.45, 5), affine_of((0.4, 0.4, 1.1), flip=(1, 1, -1)))
    yield "blobs to the edges", mirrored, around(mirrored, 0.08, 6)
    capsule = volume_of(shell((27, 27, 27), (13, 13, 13), 2.5, 12.5))
    yield "thick shell with a cavity", capsule, turning(capsule, 0.2, 0.01)
    half = np.zeros((14, 13, 12), bool)
    half[:9, 2:12, 1:11] = True
    cut = volume_of(half, affine_of((0.5, 0.5, 0.5), origin=(3, 2, 1)))
    yield "cut off by the edge", cut, turning(cut, (0.3, 0.2, 0.2), 0.01)
    yield "mean far from 0", ball, Shifts((0.9, 0, -0.4), 0.3)
    yield "error far below a voxel", ball, Shifts((0, 0, 0), 0.01)


CASES = {name: (volume, model) for name, volume, model in cases()}


def ranking_by_hand(volume, model, shape, seed, how=FEW):
    """(m, 3) voxels of the structure from the first that is avoided to the last."""
    room = 3
    solid = np.pad(volume.mask("nerve"), room)  # beyond the volume there is none of it
    voxels = np.argwhere(volume.mask("nerve"))
    outside = volume.points(np.argwhere(~solid) - float(room))
    far = cKDTree(outside).query(volume.points(voxels.astype(float)))[0].round(9)
    risk = np.zeros(len(voxels))
    if shape == SHAPES[0]:
        own = np.random.default_rng(seed).spawn(3)[2]
        landed = landing_voxels(volume, voxels, model.sample(how.violation_registrations, own))
        share = np.ones(solid.shape)
        share[tuple((voxels + room).T)] = (~looked_up(volume.mask("nerve"), landed, False)).mean(axis=0)
        risk = gaussian_filter(share, 1.0, mode="constant", cval=1.0)[tuple((voxels + room).T)].round(9)
    return voxels[np.lexsort((np.arange(len(voxels)), far, -risk))], np.sort(far)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", CASES)
def test_rim_needs_and_risks_are_those_of_brute_force(name, shape):
    volume, model = CASES[name]
    margin = grow_margin(volume, "nerve", model, 0.05, shape, FEW, 5, purpose="stay_inside")
    solid = volume.mask("nerve")
    transforms, fresh = drawn(model, 5)
    order, _ = ranking_by_hand(volume, model, shape, 5)
    lost = ~looked_up(solid, landing_voxels(volume, order, transforms), False)
    needs = np.where(lost, np.arange(1, len(order) + 1), 0).max(axis=1)
    size = np.sort(needs)[299 - ALLOWED]
    rim = np.zeros_like(solid)
    rim[tuple(order[:size].T)] = True
    assert np.array_equal(margin.mask, rim)
    assert np.array_equal(margin.needs, needs)
    assert np.array_equal(margin.inside, solid & ~rim) and margin.inside.any()
    assert margin.volume is volume and (margin.mask <= solid).all()
    assert margin.estimate.hits == (needs > size).sum() <= ALLOWED
    assert size == 0 or (needs > size - 1).sum() > ALLOWED  # one voxel less would be too little
    kept = np.argwhere(margin.inside)
    missed = ~looked_up(solid, landing_voxels(volume, kept, fresh), False)
    assert margin.validation.hits == missed.any(axis=1).sum()
    assert margin.risk_on(200, np.random.default_rng(5).spawn(3)[1]).hits == margin.validation.hits


@pytest.mark.parametrize("shape", SHAPES)
def test_needles_aimed_at_the_region_hit_the_structure(shape):
    volume, _ = CASES["ball, oblique and flipped"]
    model = RobotError(volume.points(np.array([[12.0, 10, 60]]))[0], 0.3, 0.01, np.eye(3), (0.9, 0, -0.5))
    how = GrowthSettings(registrations=3000, validation_registrations=3000)
    margin = grow_margin(volume, "nerve", model, 0.05, shape, how, 1, purpose="stay_inside")
    rng = np.random.default_rng(42)
    aims = np.argwhere(margin.inside)
    solid = volume.mask("nerve")
    transforms = model.sample(1500, rng)
    any_lost = single = 0
    for transform in transforms:
        lands = volume.points(aims.astype(float)) @ transform[:3, :3].T + transform[:3, 3]
        hit = looked_up(solid, np.floor(volume.indices(lands) + 0.5).astype(int), False)
        any_lost += not hit.all()
        single += not hit[rng.integers(len(aims))]
    # The risk is that any aim of the region fails; a needle is one aim, whose own risk is far smaller.
    assert any_lost / 1500 <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / 1500)
    assert single / 1500 < 0.02
    assert margin.validation.interval[0] <= 0.05


def test_the_rim_is_on_the_side_to_which_needles_miss():
    # Needles land 2 mm further along x: those aimed at the last two layers miss the structure.
    solid = np.zeros((20, 12, 12), bool)
    solid[4:16, 2:10, 2:10] = True
    for flip in (1, -1):
        volume = volume_of(solid, affine_of((1, 1, 1), flip=(flip, 1, 1)))
        margin = grow_margin(
            volume, "nerve", Shifts((2.0, 0, 0), 0.05), 0.05, settings=FEW, rng=0, purpose="stay_inside"
        )
        last = slice(14, 16) if flip == 1 else slice(4, 6)
        first = slice(4, 6) if flip == 1 else slice(14, 16)
        assert margin.mask[last][solid[last]].all()
        assert margin.mask[first].sum() < 0.7 * solid[first].sum()
        assert margin.validation.risk <= 0.05


def test_the_edge_of_the_volume_is_a_surface():
    # What is beyond is not known to be inside: the rim runs along the edge as along any other face.
    half = np.zeros((12, 14, 14), bool)
    half[:8, 2:12, 2:12] = True
    whole = np.zeros((20, 14, 14), bool)
    whole[4:12, 2:12, 2:12] = True
    for shape in SHAPES:
        cut, full = (
            grow_margin(
                volume_of(solid, affine_of((1, 1, 1), origin=(-first, 0, 0))),
                "nerve",
                Shifts((0, 0, 0), 0.6),
                0.05,
                shape,
                FEW,
                0,
                purpose="stay_inside",
            )
            for solid, first in ((half, 0), (whole, 4))
        )
        assert np.array_equal(cut.mask[:8], full.mask[4:12])
        assert cut.mask[0, 6, 6] and cut.inside.any()
        assert cut.edge_share > 0 == full.edge_share
        assert np.isfinite(cut.shell_distances).all()
        assert len(cut.final_shell) == len(full.final_shell)
        np.testing.assert_allclose(cut.shell_distances, full.shell_distances)


def test_nothing_left_inside_is_an_error_that_says_so():
    volume, _ = CASES["ball, oblique and flipped"]
    for shape in SHAPES:
        with pytest.raises(MarginError, match=r"in all but 8 of 300 .* innermost voxel, .* mm"):
            grow_margin(volume, "nerve", Shifts((0, 0, 0), 9), 0.05, shape, FEW, 0, purpose="stay_inside")


def test_only_the_exact_method_stays_inside():
    volume, model = CASES["ball, oblique and flipped"]
    with pytest.raises(InputError, match="method \"exact\" to stay inside, got 'published'"):
        how = GrowthSettings.for_removal("published")
        grow_margin(volume, "nerve", model, 0.05, settings=how, purpose="stay_inside")
    with pytest.raises(InputError, match="acceptable_risk: expected a number for 'nerve'"):
        grow_margin(volume, "nerve", model, purpose="stay_inside")


def test_no_error_avoids_nothing():
    volume, _ = CASES["ball, oblique and flipped"]
    for shape in SHAPES:
        margin = grow_margin(
            volume, "nerve", Shifts((0, 0, 0), 0), 0.05, shape, FEW, 0, purpose="stay_inside"
        )
        assert margin.voxels == 0 and margin.distance == 0 and margin.validation.hits == 0
        assert np.array_equal(margin.inside, volume.mask("nerve"))
        assert np.isinf(margin.shell_distances).all() and np.isnan(margin.summary()["mahalanobis_mean"])


@given(st.integers(0, 10_000), st.sampled_from(SHAPES))
@settings(max_examples=6, deadline=None)
def test_a_larger_risk_never_avoids_more(seed, shape):
    volume, model = CASES["ball, oblique and flipped"]
    rims = [
        grow_margin(volume, "nerve", model, risk, shape, FEW, seed, purpose="stay_inside").mask
        for risk in (0.02, 0.05, 0.2, 0.6)
    ]
    assert all((b <= a).all() for a, b in pairwise(rims))
    assert rims[-1].sum() < rims[0].sum()


@pytest.mark.parametrize("shape", SHAPES)
def test_curve_and_same_seed(shape):
    volume, model = CASES["thick shell with a cavity"]
    one, two = (
        grow_margin(volume, "nerve", model, 0.05, shape, FEW, 3, purpose="stay_inside") for _ in range(2)
    )
    assert one.mask.tobytes() == two.mask.tobytes() and one.validation == two.validation
    curve = one.curve()
    assert (np.diff(curve["risk"]) < 0).all() and (np.diff(curve["distance"]) >= 0).all()
    at = curve[curve["margin_voxels"] <= one.voxels].iloc[-1]
    assert at["risk"] == one.damage_risk
    summary = one.summary()
    assert summary["purpose"] == "stay_inside" and np.isfinite(summary["mahalanobis_mean"])
