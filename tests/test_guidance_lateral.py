"""Table 1 of Baron: its numbers, its factors, and bands that hold what they promise."""

import numpy as np
import pytest

from study import published
from study.errors import InputError
from study.experiments.guidance_bands import compare, conditions, prediction_band
from study.experiments.guidance_lateral import (
    QUANTITIES,
    SIDES,
    agreement,
    agreement_in_words,
    cause_table,
    corrected_sums,
    factors,
    hole_statistics,
    many_blocks,
    one_block,
    printed,
    table_1,
)


def test_numbers_of_a_block():
    rng = np.random.default_rng(1)
    d = rng.normal(size=(5, 24, 2)) @ np.array([[0.2, 0.1], [0.0, 0.05]]) + [0.3, -0.1]
    for one, found in zip(d, hole_statistics(d), strict=True):
        covariance = np.cov(one.T)
        major, minor = np.sqrt(np.linalg.svd(covariance)[1])
        mean = one.mean(axis=0)
        region = 3.2905267314919255 * major
        wanted = [*mean, *np.sqrt(np.diag(covariance)), major, minor, region, np.hypot(*mean) + region]
        assert found == pytest.approx(wanted, rel=1e-12)


def test_print_was_computed_that_way():
    """Mean plus region and the region's factor follow from the other printed columns, to their last digit."""
    for name in ("hannover", "vanderbilt"):
        for row in printed(name):
            got = dict(zip(QUANTITIES, row, strict=True))
            region = factors()["one dimension"] * got["std_major_axis_mm"]
            assert abs(region - got["confidence_999_major_axis_mm"]) < 3.3 * 0.0005 + 0.0005
            total = np.hypot(got["mean_x_mm"], got["mean_y_mm"]) + got["confidence_999_major_axis_mm"]
            assert abs(total - got["mean_plus_confidence_max_mm"]) < 0.0015


def test_factors():
    assert list(factors(24).values()) == pytest.approx([3.2905, 3.7169, 4.576], abs=5e-4)


def test_printed_is_the_published_table():
    table = published.table("Baron 1")
    for name in ("hannover", "vanderbilt"):
        rows = table[table["system"] == name]
        assert printed(name).shape == (len(SIDES), len(QUANTITIES)) == (len(rows), 8)


@pytest.mark.parametrize("n", [12, 40, 200])
def test_a_band_holds_one_more(n):
    rng = np.random.default_rng(n)
    hits, coverage = 0, 0.0
    for _ in range(4000):
        values = rng.exponential(size=n + 1)
        low, high, coverage = prediction_band(values[:-1])
        hits += low <= values[-1] <= high
    assert abs(hits / 4000 - coverage) < 4 * np.sqrt(coverage * (1 - coverage) / 4000)
    assert coverage == pytest.approx(0.95, abs=0.02) or n < 39


def test_print_far_away_is_outside_and_unusual():
    rng = np.random.default_rng(0)
    simulated = rng.normal(size=(199, 4))
    far = compare([0.0, 9.0, -9.0, 0.1], simulated)
    assert far.inside.tolist() == [True, False, False, True]
    assert far.as_unusual < 0.05
    near = compare(np.zeros(4), simulated)
    assert near.inside.all()
    assert near.as_unusual == 1.0


@pytest.mark.parametrize("bad", [[], [1.0], [np.nan, 1.0]])
def test_no_band_of_nothing(bad):
    with pytest.raises(InputError):
        prediction_band(bad)


def test_few_holes_have_no_ellipse():
    with pytest.raises(InputError, match="3 or more"):
        hole_statistics(np.zeros((2, 2)))


def test_a_page_of_two_blocks():
    bands = many_blocks(2, names=("vanderbilt",))
    assert [one.name for one in bands.conditions["vanderbilt"]] == ["stated", "drawn", "force"]
    table = table_1({"vanderbilt": one_block("vanderbilt")}, bands)
    assert len(table) == 16
    assert (table["stated_low_mm"] <= table["stated_high_mm"]).all()
    # The force bends the drill along x of the block, by 3 N over the stiffness of its bit.
    shift = bands.numbers("vanderbilt", "force")[..., 0] - bands.numbers("vanderbilt", "stated")[..., 0]
    stiffness = conditions("vanderbilt")[0].system.bit_stiffness_n_mm
    assert shift == pytest.approx(3.0 / stiffness, abs=0.02)
    found = agreement(bands)
    assert "Vanderbilt, causes as stated" in agreement_in_words(found)
    sums = corrected_sums(bands)
    first = sums[(sums["side"] == "top") & (sums["region"] == "one dimension")]
    assert first["printed_mm"].item() == pytest.approx(0.840, abs=0.003)


def test_every_cause_is_shown_with_its_unit_apart():
    table = cause_table()
    assert not table["cause"].str.endswith(("mm", " s", "mrad")).any()
    assert (table["source"].str.len() > 10).all()
