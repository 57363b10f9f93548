"""The margin as an order statistic: against brute force, voxel by voxel and registration by registration."""

from functools import cache

import numpy as np
import pytest
from margin_cases import (
    CASES,
    around,
    corner_hits,
    damaging_by_hand,
    distances_by_hand,
    needs_by_hand,
    tube,
    volume_of,
)
from scipy import ndimage, stats

from study.margins import GrowthSettings, allowed_hits, exact, grow_margin, overall_risk
from study.registration import PointRegistration, displacement_moments

SHAPES = ["spatially_varying", "constant_thickness"]
FEW = GrowthSettings(registrations=300, validation_registrations=200)


def margin_and_ranks(name, shape, risk=0.05, settings=FEW, seed=3):
    """A margin, and when each voxel of the volume enters it (those without a rank after all others)."""
    volume, model = CASES[name]
    margin = grow_margin(volume, "nerve", model, risk, shape=shape, settings=settings, rng=seed)
    order, region = margin.choice.ranking.order, margin.choice.region
    ranks = np.full(region.shape, len(order) + 1)
    ranks.reshape(-1)[order] = np.arange(1, len(order) + 1)
    whole = np.full(volume.shape, len(order) + 1)
    whole[tuple(slice(a, a + n) for a, n in zip(region.low, region.shape, strict=True))] = ranks
    whole[margin.structure_mask] = 0
    return margin, whole


@cache
def drawn_hits(name, seed=3):
    """What the registrations that a seed gives do: those to grow on, and those to validate on."""
    volume, model = CASES[name]
    growing, validating = np.random.default_rng(seed).spawn(2)
    return tuple(
        corner_hits(volume, volume.mask("nerve"), model.sample(count, rng))
        for count, rng in ((300, growing), (200, validating))
    )


@pytest.mark.parametrize("shape, remember", [(SHAPES[0], True), (SHAPES[1], True), (SHAPES[0], False)])
@pytest.mark.parametrize("name", CASES)
def test_needs_margin_and_risks_are_those_of_brute_force(name, remember, shape, monkeypatch):
    if not remember:
        monkeypatch.setattr(overall_risk, "_MOST_REMEMBERED", 0)
    margin, ranks = margin_and_ranks(name, shape)
    solid = margin.structure_mask
    hits, fresh_hits = drawn_hits(name)
    needs = needs_by_hand(ranks, hits)
    assert np.array_equal(margin.needs, needs)
    # No more registrations than allowed need more than the margin, and one voxel less would be too little.
    allowed = allowed_hits(300, 0.05, 0.95)
    assert margin.voxels == np.sort(needs)[299 - allowed]
    assert np.count_nonzero(needs > margin.voxels) <= allowed
    assert margin.voxels == 0 or np.count_nonzero(needs > margin.voxels - 1) > allowed
    assert np.array_equal(margin.mask, (ranks > 0) & (ranks <= margin.voxels))
    assert margin.estimate.hits == damaging_by_hand(solid, margin.mask, hits).sum()
    assert margin.validation.hits == damaging_by_hand(solid, margin.mask, fresh_hits).sum()
    assert margin.risk_on(200, np.random.default_rng(3).spawn(2)[1]).hits == margin.validation.hits


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", CASES)
def test_ranks_go_by_the_smallest_distance_and_miss_no_voxel(name, shape):
    margin, ranks = margin_and_ranks(name, shape)
    ranking, solid = margin.choice.ranking, margin.structure_mask
    moments = displacement_moments(margin.model)

    def by_hand(voxels):
        spread = moments.at(margin.volume.points(voxels.astype(float))) if shape == SHAPES[0] else None
        return distances_by_hand(margin.volume, solid, voxels, spread)

    ranked = np.argwhere((ranks > 0) & (ranks <= len(ranking.order)))
    at = ranks[tuple(ranked.T)] - 1
    np.testing.assert_allclose(ranking.distances[at], by_hand(ranked), rtol=1e-6)
    assert np.all(np.diff(ranking.distances) >= -1e-8 * ranking.distances.max())
    left = np.argwhere(ranks > len(ranking.order))
    if len(left) and len(ranked):
        assert by_hand(left).min() >= ranking.distances.max() * (1 - 1e-6)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", ["tube", "hollow", "at the edge on all sides", "farther than it is thick"])
def test_curve_is_the_risk_of_margins_made_by_hand(name, shape):
    margin, ranks = margin_and_ranks(name, shape)
    curve = margin.curve()
    hits, _ = drawn_hits(name)
    assert (np.diff(curve["risk"]) < 0).all() and (np.diff(curve["margin_voxels"]) > 0).all()
    assert curve["margin_voxels"].iloc[0] == 0
    for row in curve.iloc[:: max(1, len(curve) // 12)].itertuples():
        mask = (ranks > 0) & (ranks <= row.margin_voxels)
        assert row.risk == damaging_by_hand(margin.structure_mask, mask, hits).mean()
        assert row.volume_mm3 == pytest.approx(mask.sum() * margin.volume.voxel_volume)
    at_margin = curve[curve["margin_voxels"] <= margin.voxels].iloc[-1]
    assert at_margin["risk"] == margin.damage_risk
    assert curve["risk"].iloc[-1] <= 0.05 / 3
    far = curve["distance"].to_numpy()
    assert (np.diff(far) >= -1e-8).all() and far[0] == 0


@pytest.mark.parametrize("shape", SHAPES)
def test_where_ranking_begins_changes_nothing(shape, monkeypatch):
    plain, _ = margin_and_ranks("tube", shape)
    begin = exact.first_cut
    for share in (0.3, 0.7, 2.0):
        monkeypatch.setattr(exact, "first_cut", lambda *given, share=share: share * begin(*given))
        other, _ = margin_and_ranks("tube", shape)
        assert np.array_equal(other.mask, plain.mask)
        assert other.estimate == plain.estimate and other.validation == plain.validation
        least = min(len(other.choice.ranking.order), len(plain.choice.ranking.order))
        assert np.array_equal(np.minimum(other.needs, least), np.minimum(plain.needs, least))


@pytest.mark.parametrize("shape", SHAPES)
def test_same_seed_same_bytes(shape):
    first, second = (margin_and_ranks("hollow", shape, seed=8)[0] for _ in range(2))
    assert first.mask.tobytes() == second.mask.tobytes() and first.needs.tobytes() == second.needs.tobytes()
    assert first.choice.ranking.order.tobytes() == second.choice.ranking.order.tobytes()
    assert first.curve().equals(second.curve())
    assert first.validation == second.validation
    volume, model = CASES["hollow"]
    third = grow_margin(volume, "nerve", model, 0.05, shape, FEW, rng=np.random.default_rng(8))
    assert third.mask.tobytes() == first.mask.tobytes()
    assert not np.array_equal(margin_and_ranks("hollow", shape, seed=9)[0].needs, first.needs)


def test_ties_are_broken_by_place():
    margin, _ = margin_and_ranks("hollow", "constant_thickness")
    ranking = margin.choice.ranking
    same = np.isclose(np.diff(ranking.distances), 0, rtol=0, atol=1e-9)
    assert same.mean() > 0.5  # there are many
    assert (np.diff(ranking.order)[same] > 0).all()


def test_shell_distances_and_summary():
    for shape in SHAPES:
        margin, _ = margin_and_ranks("oblique, anisotropic, several parts", shape)
        union = margin.mask | margin.structure_mask
        faces = ndimage.generate_binary_structure(3, 1)
        shell = np.argwhere(ndimage.binary_dilation(union, faces) & ~union)
        assert np.array_equal(margin.final_shell, shell)
        spread = displacement_moments(margin.model).at(margin.volume.points(shell.astype(float)))
        far = distances_by_hand(margin.volume, margin.structure_mask, shell, spread)
        np.testing.assert_allclose(margin.shell_distances, far, rtol=1e-6)
        np.testing.assert_allclose(margin.shell_point_risks, stats.chi2(3).sf(far**2), rtol=1e-4)
        summary = margin.summary()
        assert summary["mahalanobis_mean"] == pytest.approx(far.mean(), rel=1e-6)
        assert summary["mahalanobis_std"] == pytest.approx(far.std(ddof=1), rel=1e-6)
        assert summary["safety_margin_volume_mm3"] == pytest.approx(
            margin.mask.sum() * margin.volume.voxel_volume
        )
        assert summary["final_damage_probability"] == margin.estimate.hits / 300
        interval = stats.binomtest(margin.validation.hits, 200).proportion_ci(0.95, "exact")
        assert (summary["validation_low"], summary["validation_high"]) == tuple(interval)


def test_a_wider_error_or_a_smaller_risk_needs_more():
    volume, _ = CASES["tube"]
    settings = GrowthSettings(registrations=2000, validation_registrations=0)
    sizes = [
        grow_margin(volume, "nerve", around(volume, fle), risk, settings=settings, rng=0).voxels
        for fle, risk in ((0.1, 0.05), (0.6, 0.05), (0.6, 0.01))
    ]
    assert sizes[0] < sizes[1] < sizes[2]


def test_spatially_varying_margins_are_thicker_where_the_error_is_wider():
    # Far from the fiducials the error is several times what it is among them.
    volume = volume_of(tube((90, 21, 21), (5, 10, 10), (84, 10, 10)))
    near = volume.points(np.array([[5.0, 10, 10]]))
    model = PointRegistration(near + np.random.default_rng(0).normal(size=(6, 3)) * 8, 0.2)
    wide = model.tre_rms(volume.points(np.array([[5.0, 10, 10], [84, 10, 10]])))
    assert wide[1] > 2 * wide[0]
    settings = GrowthSettings(registrations=4000, validation_registrations=4000)
    varying, constant = (grow_margin(volume, "nerve", model, 0.02, shape, settings, 0) for shape in SHAPES)
    ends = [margin.mask[10:20].sum() / margin.mask[70:80].sum() for margin in (varying, constant)]
    assert ends[0] < 0.5 and ends[1] == pytest.approx(1, abs=0.05)
    assert varying.voxels < constant.voxels  # here varying saves tissue
    for margin in (varying, constant):
        assert margin.validation.interval[0] <= 0.02
