import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from study.audit import milled
from study.errors import FileFormatError, InputError
from study.robots.resistance import fit_resistance

VOLUME = [1.0, 2.0, 3.0, 4.5, 6.0]


@settings(max_examples=25)
@given(st.floats(0, 60), st.floats(0, 60))
def test_known_coefficients_are_found(start, per_cm3):
    excess = start + per_cm3 * np.array(VOLUME)
    model = fit_resistance(excess, {"removed_cm3": VOLUME})
    assert model.coefficients == pytest.approx([start, per_cm3], abs=1e-6)
    assert model.excess({"removed_cm3": [10.0]}) == pytest.approx([start + 10 * per_cm3], abs=1e-5)


def test_fit_against_linregress():
    excess = [50.0, 80.0, 101.0, 140.0, 170.0]
    model, line = fit_resistance(excess, {"removed_cm3": VOLUME}), stats.linregress(VOLUME, excess)
    assert model.coefficients == pytest.approx([line.intercept, line.slope])
    t = stats.t.ppf(0.975, 3)
    assert model.intervals() == pytest.approx([t * line.intercept_stderr, t * line.stderr])


def test_prediction_interval_covers_as_often_as_it_says():
    rng, inside, runs = np.random.default_rng(1), 0, 2000
    for _ in range(runs):
        excess = 30 + 25 * np.array(VOLUME) + rng.normal(0, 8, len(VOLUME))
        model = fit_resistance(excess, {"removed_cm3": VOLUME})
        new, at = 30 + 25 * 8.0 + rng.normal(0, 8), {"removed_cm3": [8.0]}
        inside += bool(abs(new - model.excess(at)[0]) <= model.half_width(at)[0])
    assert stats.binomtest(inside, runs, 0.95).pvalue > 1e-3


def test_no_resistance_adds_nothing():
    model = fit_resistance([3.0, 4.0], {"removed_cm3": [1.0, 2.0]}, terms=())
    assert model.excess({"removed_cm3": [1.0, 2.0, 3.0]}).tolist() == [0, 0, 0]
    assert model.residual_std_s == pytest.approx(np.sqrt(12.5))


@pytest.mark.parametrize(
    ("excess", "columns", "terms", "words"),
    [
        ([1, 2, 3], {"removed_cm3": [1, 2, 3]}, ("force",), "force"),
        ([1, 2, 3], {"removed_cm3": [1, 2, 3]}, ("start", "start"), "different"),
        ([1, 2, 3], {}, ("removed_cm3",), "no column for removed_cm3"),
        ([1, 2, 3], {"removed_cm3": [1, 2]}, ("removed_cm3",), "3 finite"),
        ([1, 2, 3], {"removed_cm3": [1, 2, np.inf]}, ("removed_cm3",), "finite"),
        ([1, 2], {"removed_cm3": [1, 2]}, ("start", "removed_cm3"), "2 millings"),
        ([1, np.nan, 2], {"removed_cm3": [1, 2, 3]}, ("start",), "excess"),
        ([1, 2, 3], {"removed_cm3": [2, 2, 2]}, ("start", "removed_cm3"), "told apart"),
    ],
)
def test_bad_input(excess, columns, terms, words):
    with pytest.raises(InputError, match=words):
        fit_resistance(excess, columns, terms)


def test_milled_bones():
    bones = milled.milled_bones()
    assert bones["milled_with"].value_counts().to_dict() == {"3d": 8, "zigzag": 7}
    assert (abs(bones["difference_pct"] - bones["printed_difference_pct"]) <= 0.51).all()
    assert (bones["excess_s"] > 0).all()
    # true millimetres: a path in contact is longer than the printed centimetres
    assert bones.loc["TB01", "contact_length_mm"] == pytest.approx(9490 * 0.66)


def test_volume_foresees_the_other_strategy_best():
    """Fitted on either strategy, start and volume foresee the other best, within 2 %."""
    bones = milled.milled_bones()
    for on in ("zigzag", "3d"):
        models = milled.compare_models(bones, on).set_index("model")
        assert models["rmse_s"].idxmin() == "start and volume"
        assert (
            abs(models.loc["start and volume", "mean_error_pct"])
            < 2
            < models.loc["no resistance", "mean_error_pct"]
        )


def test_models_never_see_the_bones_they_foresee():
    bones = milled.milled_bones()
    changed = bones.copy()
    changed.loc[changed["milled_with"] == "3d", "excess_s"] += 1000
    before = milled.fitted(bones, "start and volume").coefficients
    assert milled.fitted(changed, "start and volume").coefficients == pytest.approx(before)


def test_resistance_per_volume_does_not_differ_between_strategies():
    table = milled.strategies_compared(milled.milled_bones()).set_index("quantity")
    volume = table.loc["per volume (s/cm³)"]
    assert abs(volume["difference"]) < volume["difference_plus_minus"]
    assert volume["p_value"] > 0.05
    assert volume["zigzag"] - volume["zigzag_plus_minus"] > 0  # but it is not zero


def test_unknown_models_and_strategies():
    bones = milled.milled_bones()
    with pytest.raises(InputError, match="start and volume"):
        milled.fitted(bones, "force")
    with pytest.raises(InputError, match="zigzag, 3d"):
        milled.fitted(bones, "volume", "spiral")


def test_measured_rows(tmp_path):
    assert milled.measured_rows(tmp_path) == {}
    empty = milled.predicted_beside_measured({})
    assert len(empty) == 15
    assert empty["3d_measured_s"].isna().all()
    rows = pd.DataFrame(
        {
            "specimen": ["TB01", "CH01"],
            "modified_initial_target_cm3": [4.0, 2.0],
            "predicted_milling_time_s": [9.0, 5.0],
        }
    )
    rows.to_csv(tmp_path / "appendix_a_3d_4dof.csv", index=False)
    measured = milled.measured_rows(tmp_path)
    assert list(measured) == ["3d"]
    beside = milled.predicted_beside_measured(measured).set_index("specimen")
    assert beside.loc["TB01", "3d_measured_s"] == 9
    assert beside["3d_measured_s"].notna().sum() == 1
    rows.drop(columns="predicted_milling_time_s").to_csv(tmp_path / "appendix_a_3d_4dof.csv", index=False)
    with pytest.raises(FileFormatError, match="predicted_milling_time_s"):
        milled.measured_rows(tmp_path)


def test_pictures(tmp_path):
    bones = milled.milled_bones()
    measured = {k: milled.rows(name) for k, name in milled.STRATEGIES.items()}
    for k, figure in enumerate(
        [milled.figure_2_21(bones), milled.figure_2_20(), milled.figure_2_20(measured)]
    ):
        figure.savefig(tmp_path / f"{k}.png", dpi=40)
        assert (tmp_path / f"{k}.png").stat().st_size > 2000
    assert len(milled.figure_2_20(measured).axes) == 2
