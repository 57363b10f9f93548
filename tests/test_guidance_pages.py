"""What the notebooks on the guided robot compute: Table 1, bands, comparisons, variants."""

import numpy as np
import pytest

from study.errors import InputError
from study.experiments.guidance_absolute import absolute_table, counts, in_words, overruns
from study.experiments.guidance_bands import compare
from study.experiments.guidance_design import NOT_HERE, improvements, limit_mm
from study.experiments.guidance_lateral import cause_title, factors, hole_statistics
from study.experiments.guidance_variants import Variant, jackknife, lateral_runs, radius_999, upper_bound
from study.guidance import causes, system

RNG = np.random.default_rng(0)


def test_factors_hold_what_they_say():
    k = factors()
    assert k["one dimension"] < k["two dimensions"] < k["one hole more"]
    radii = np.linalg.norm(RNG.normal(size=(400_000, 2)), axis=1)
    assert np.mean(radii > k["two dimensions"]) == pytest.approx(1e-3, abs=2e-4)


def test_a_print_from_the_model_is_as_unusual_as_chance():
    unusual = []
    for _ in range(300):
        draws = RNG.normal(size=(60, 6)) + RNG.normal(size=(60, 1))
        unusual.append(compare(draws[0], draws[1:]).as_unusual)
    assert np.mean(np.array(unusual) <= 0.1) <= 0.15
    far = compare(np.full(6, 9.0), RNG.normal(size=(60, 6)))
    assert not far.inside.any()
    assert far.as_unusual == pytest.approx(1 / 61)


def test_bad_numbers_are_refused():
    with pytest.raises(InputError):
        compare([0.0, np.nan], np.zeros((5, 2)))
    with pytest.raises(InputError):
        hole_statistics(np.zeros((2, 2)))


def test_radius_and_jackknife_of_a_known_normal():
    errors = 0.1 * RNG.normal(size=(2000, 2, 2))
    radius, half = jackknife(radius_999, errors)
    assert radius == pytest.approx(0.1 * factors()["two dimensions"], abs=2 * half)
    assert upper_bound(0, 2995) <= 1e-3 < upper_bound(0, 2990)


def test_variants_share_their_luck_and_improvements_are_in_range():
    runs = lateral_runs(system("vanderbilt"), [Variant("a"), Variant("b")], 2)
    assert np.array_equal(runs.of(0), runs.of(1))
    table = causes()
    for one in improvements().values():
        for cause, value in one.changes.items():
            assert cause not in NOT_HERE
            assert table.loc[cause, "low"] <= value <= table.loc[cause, "high"]
    assert limit_mm() == 0.5


def test_causes_in_words():
    assert cause_title("insertion_mm_s", "mm/s") == "insertion"
    assert cause_title("calibration_force_n", "N") == "calibration force"
    assert cause_title("touches", "1") == "touches"


def test_too_few_experiments_say_nothing():
    errors = np.random.default_rng(0).normal(size=(4, 2, 2))
    assert np.isnan(jackknife(radius_999, errors[:2])).all()
    radius, half = jackknife(radius_999, errors[:3])
    assert radius == radius_999(errors[:3])
    assert np.isnan(half)
    assert np.isfinite(jackknife(radius_999, errors)).all()


def test_pi_alone_adds_to_the_targets_distance_only():
    deep = overruns(2)
    told, alone = deep["target_rms_mm"]
    assert alone > told
    assert abs(np.diff(deep["axis_rms_mm"]).item()) < 0.05


def test_absolute_page_in_words():
    table, runs = absolute_table(4)
    counted = counts(runs)
    inside = [int((table[f"{name}_inside"] == "yes").sum()) for name in runs]
    assert counted["inside_of_4"].tolist() == inside
    beyond = [100 * (run.values[:, 0] > 1.0).mean() for run in runs.values()]
    assert counted["targets_beyond_1_mm_pct"].tolist() == pytest.approx(beyond)
    assert "1.39 mm" in in_words(counted)  # of the print: 0.62 + 3.09 * 0.25
