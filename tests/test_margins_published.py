"""The printed growth, step by step; and how many registrations may do damage."""

import itertools
import math
from functools import cache

import numpy as np
import pytest
from margin_cases import CASES, Shifts, around, corner_hits, damaging_by_hand, touched, tube, volume_of
from scipy import integrate, ndimage, special, stats

from study.errors import InputError, MarginError
from study.margins import (
    ACCEPTABLE_RISKS,
    DECAY_STARTS,
    GrowthSettings,
    RiskEstimate,
    allowed_hits,
    grow_margin,
    least_registrations,
)
from study.margins.published import transfer_share
from study.registration import displacement_moments

SHAPES = ["spatially_varying", "constant_thickness"]
PRINTED = GrowthSettings(method="published", registrations=120, validation_registrations=120)


def grown(name, shape="spatially_varying", risk=0.05, settings=PRINTED, rng=4):
    volume, model = CASES[name]
    return grow_margin(volume, "nerve", model, risk, shape=shape, settings=settings, rng=rng)


# --- the printed loop -------------------------------------------------------------------------------------


def test_printed_parameters_are_the_defaults():
    settings = GrowthSettings()
    assert (settings.registrations, settings.initial_transfer) == (25_000, 0.2)
    assert ACCEPTABLE_RISKS == {
        "facial_nerve": 0.001,
        "chorda_tympani": 0.05,
        "internal_auditory_canal": 0.01,
        "sigmoid_sinus": 0.01,
        "external_auditory_canal": 0.05,
    }
    assert set(DECAY_STARTS) == set(ACCEPTABLE_RISKS)
    for structure, start in DECAY_STARTS.items():
        assert settings.decay_start_of(structure) == start
        assert GrowthSettings(decay_start=0.7).decay_start_of(structure) == 0.7


def test_transfer_share_at_its_ends():
    assert transfer_share(1.0, 0.01, 0.2, 0.5) == transfer_share(0.5, 0.01, 0.2, 0.5) == 0.2
    assert transfer_share(0.01, 0.01, 0.2, 0.5) == 0
    assert transfer_share(0.255, 0.01, 0.2, 0.5) == pytest.approx(0.1)  # half way
    assert transfer_share(0.3, 0.01, 0.4, 1.0) == pytest.approx(0.4 * 0.29 / 0.99)
    assert transfer_share(0.6, 0.5, 0.2, 0.5) == 0.2  # nothing to decay over


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", ["oblique, anisotropic, several parts", "at the edge on all sides"])
def test_every_step_is_the_printed_one(name, shape):
    margin = grown(name, shape)
    volume, solid, history = margin.volume, margin.structure_mask, margin.history
    growing, validating = np.random.default_rng(4).spawn(2)
    moments = displacement_moments(margin.model)
    lattice = touched(solid.astype(int), 0) > 0
    surface = volume.points(np.argwhere(lattice & (touched((~solid).astype(int), 0) > 0)) - 0.5)
    grown_by_hand = np.zeros(volume.shape, bool)
    everywhere = ndimage.generate_binary_structure(3, 3)

    def risk_by_hand(rng, count):
        union = solid | grown_by_hand
        corners = (touched(union.astype(int), 0) > 0) & (touched((~union).astype(int), 0) > 0)
        hits = corner_hits(volume, solid, margin.model.sample(count, rng))
        return (hits & corners.reshape(-1)).any(axis=1).mean()

    @cache
    def distance(*voxel):
        point = volume.points(np.array([voxel], float))
        metric = np.linalg.inv(moments.at(point)[0]) if shape == SHAPES[0] else np.eye(3)
        step = surface - point
        return np.einsum("ni,ij,nj->n", step, metric, step).min()

    for row in history.itertuples():
        risk = risk_by_hand(growing, 120)
        union = solid | grown_by_hand
        shell = np.argwhere(ndimage.binary_dilation(union, everywhere) & ~union)
        share = transfer_share(risk, 0.05, 0.2, 0.5)
        assert row.margin_voxels == grown_by_hand.sum()
        assert row.shell_voxels == len(shell)
        assert row.risk == risk
        assert row.transfer_share == pytest.approx(share)
        if risk <= 0.05:
            break
        far = np.array([distance(*voxel) for voxel in shell])
        place = np.ravel_multi_index(tuple(shell.T), volume.shape)
        chosen = np.lexsort((place, np.rint(far * 1e7)))[: max(1, int(share * len(shell)))]
        grown_by_hand[tuple(shell[chosen].T)] = True
    assert row.Index == len(history) - 1
    assert np.array_equal(margin.mask, grown_by_hand)
    assert margin.damage_risk == risk <= 0.05
    assert margin.voxels == history["margin_voxels"].iloc[-1]
    assert margin.validation.risk == risk_by_hand(validating, 120)


@pytest.mark.parametrize("shape", SHAPES)
def test_history_grows_and_is_its_own_curve(shape):
    margin = grown("tube", shape)
    history, curve = margin.history, margin.curve()
    assert (np.diff(history["margin_voxels"]) > 0).all() and history["margin_voxels"].iloc[0] == 0
    assert (history["risk"].iloc[:-1] > 0.05).all() and history["risk"].iloc[-1] <= 0.05
    assert curve["margin_voxels"].equals(history["margin_voxels"]) and curve["risk"].equals(history["risk"])
    np.testing.assert_allclose(curve["volume_mm3"], curve["margin_voxels"] * 0.064)
    with pytest.raises(MarginError, match="exact"):
        _ = margin.needs


def test_least_transfer_is_kept():
    volume, model = CASES["tube"]
    for least in (1, 30):
        settings = GrowthSettings(
            method="published",
            registrations=300,
            validation_registrations=0,
            least_transfer=least,
            initial_transfer=1e-9,
        )
        margin = grow_margin(volume, "nerve", model, 0.3, settings=settings, rng=1)
        assert set(np.diff(margin.history["margin_voxels"])) == {least}
        assert margin.validation is None


def test_growth_that_takes_too_many_steps_is_an_error():
    settings = GrowthSettings(method="published", registrations=300, initial_transfer=0.01, most_steps=7)
    with pytest.raises(MarginError, match=r"at most 0\.001 within 7 steps, got [01]"):
        grown("tube", risk=0.001, settings=settings)


def test_same_seed_same_bytes():
    first, second, third = grown("hollow"), grown("hollow"), grown("hollow", rng=5)
    assert first.mask.tobytes() == second.mask.tobytes() and first.history.equals(second.history)
    assert first.validation == second.validation
    assert not first.history.equals(third.history)


@pytest.mark.parametrize("shape", SHAPES)
def test_both_methods_come_to_similar_margins(shape):
    volume = volume_of(tube((24, 24, 40), (10, 10, 6), (13, 12, 33)))
    model = around(volume, 0.4, 2)
    found = {}
    for method, confidence in (("published", None), ("exact", None), ("exact", 0.95)):
        settings = GrowthSettings(method=method, registrations=5000, confidence=confidence)
        margin = grow_margin(volume, "nerve", model, 0.05, shape=shape, settings=settings, rng=0)
        found[method, confidence] = margin.voxels
        assert margin.damage_risk <= 0.05
        assert margin.validation.risk == pytest.approx(0.05, abs=0.02)
    assert found["exact", None] <= found["exact", 0.95]
    assert found["published", None] == pytest.approx(found["exact", None], rel=0.15)


# --- order statistics -------------------------------------------------------------------------------------


@pytest.mark.parametrize("risk", [0.001, 0.01, 0.05, 0.3, 0.7])
@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.95, 0.999])
def test_allowed_hits_is_wilks_rule(risk, confidence):
    for registrations in (least_registrations(risk, confidence), 300, 2000, 25_000):
        if registrations < least_registrations(risk, confidence):
            continue
        m = allowed_hits(registrations, risk, confidence)
        # P(Beta(m+1, N-m) <= r): more than m of N draws below r.
        sure = [1 - stats.binom.cdf(k, registrations, risk) for k in (m, m + 1)]
        assert sure[0] >= confidence > sure[1]
        assert special.betainc(m + 1, registrations - m, risk) == pytest.approx(sure[0], rel=1e-9)


def test_beta_by_the_integral_it_stands_for():
    n, m, risk = 100, 2, 0.07
    density = math.factorial(n) / math.factorial(m) / math.factorial(n - m - 1)
    sure = integrate.quad(lambda p: density * p**m * (1 - p) ** (n - m - 1), 0, risk)[0]
    assert allowed_hits(n, risk, sure * 0.999999) == m
    assert allowed_hits(n, risk, min(sure * 1.000001, 0.999999)) == m - 1


@pytest.mark.parametrize(
    "risk, confidence, least",
    [
        (0.05, 0.95, 59),
        (0.01, 0.95, 299),
        (0.001, 0.95, 2995),
        (0.1, 0.9, 22),
        (0.01, 0.99, 459),
        (0.5, 0.5, 1),
    ],
)
def test_least_registrations_are_the_known_ones(risk, confidence, least):
    assert least_registrations(risk, confidence) == least
    assert allowed_hits(least, risk, confidence) == 0
    assert (1 - risk) ** least <= 1 - confidence + 1e-12
    if least > 1:
        assert (1 - risk) ** (least - 1) > 1 - confidence
        with pytest.raises(InputError, match=f"at least {least} .*{risk}.*{confidence}, got {least - 1}"):
            allowed_hits(least - 1, risk, confidence)


def test_plain_quantile():
    for n, risk in itertools.product((1, 7, 100, 1000, 25_000), (0.001, 0.05, 0.29, 0.999)):
        m = allowed_hits(n, risk, None)
        assert m / n <= risk * (1 + 1e-9) or n == 1
        assert m == n - 1 or (m + 1) / n > risk
    assert allowed_hits(1000, 0.29, None) == 290  # 1000 * 0.29 is below 290 in binary


def test_confidence_is_kept_and_the_plain_quantile_does_not_keep_it():
    # True risks from 200 000 registrations; the error of a voxel's step in the margin adds to it.
    volume = volume_of(tube((13, 13, 16), (5, 6, 2), (7, 6, 13)))
    model, runs, n, risk = around(volume, 0.5, 1), 150, 200, 0.05
    wide = GrowthSettings(registrations=60_000, confidence=None, validation_registrations=0)
    reference = grow_margin(volume, "nerve", model, 0.01, settings=wide, rng=99).curve()
    sizes, risks = reference["margin_voxels"].to_numpy(), reference["risk"].to_numpy()
    above = {}
    for confidence in (None, 0.95):
        settings = GrowthSettings(registrations=n, confidence=confidence, validation_registrations=0)
        found = [
            grow_margin(volume, "nerve", model, risk, settings=settings, rng=[7, run]).voxels
            for run in range(runs)
        ]
        true = risks[np.searchsorted(sizes, found, side="right") - 1]
        above[confidence] = int((true > risk).sum())
    assert above[0.95] <= stats.binom.isf(1e-4, runs, 0.05)
    assert stats.binom.isf(1 - 1e-4, runs, 0.35) <= above[None] <= stats.binom.isf(1e-4, runs, 0.6)


@pytest.mark.parametrize("hits, n", [(0, 500), (3, 500), (250, 500), (500, 500)])
def test_intervals_are_those_of_clopper_and_pearson(hits, n):
    low, high = RiskEstimate(hits, n).interval
    assert low == pytest.approx(stats.beta.ppf(0.025, hits, n - hits + 1) if hits else 0, abs=1e-9)
    assert high == pytest.approx(stats.beta.ppf(0.975, hits + 1, n - hits) if hits < n else 1, abs=1e-9)
    narrow = RiskEstimate(hits, n, level=0.5).interval
    assert low <= narrow[0] <= RiskEstimate(hits, n).risk <= narrow[1] <= high


# --- another model than the margin's ----------------------------------------------------------------------


def test_risk_under_another_error():
    margin = grown("tube")
    worse = margin.risk_on(2000, 1, Shifts((0.5, 0.5, 0.5), 0.2))
    assert worse.risk > 0.2 > margin.risk_on(2000, 1).risk
    assert margin.risk_on(2000, 1) == margin.risk_on(2000, np.random.default_rng(1))
    with pytest.raises(InputError, match="registrations"):
        margin.risk_on(0)


def test_risk_on_sees_all_tissue_that_may_be_milled():
    """Also what jumps right over margin and structure, of which the analyzed shell knows nothing."""
    volume, _ = CASES["tube"]
    settings = GrowthSettings(registrations=500, validation_registrations=0)
    margin = grow_margin(volume, "nerve", around(volume, 0.1), 0.05, settings=settings, rng=0)
    for shift in (1.0, 2.0, 3.0):
        other = Shifts((0, 0, shift), 0.1)
        hits = corner_hits(volume, margin.structure_mask, other.sample(100, 1))
        by_hand = damaging_by_hand(margin.structure_mask, margin.mask, hits)
        assert margin.risk_on(100, 1, other).hits == by_hand.sum() == 100
