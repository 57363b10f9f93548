"""Rows, means and claims of Table 3.2: plain-Python parts against references."""

import zlib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from real_data import real
from scipy import ndimage

from study.cases import Case, load_case
from study.errors import InputError
from study.experiments.equal_risk import equal_risk_ratio, volumes_at_risks
from study.experiments.margin_claims import measured_means, own_claims, printed_means, table_claims
from study.experiments.margin_survey import at_voxel_size, reason_to_skip
from study.experiments.margin_table import (
    QUANTITIES,
    VARIANTS,
    beside_each_other,
    measured_table,
    printed_table,
    run_margin_table,
    select_bones,
    structures_table,
    times_table,
)
from study.margins import ACCEPTABLE_RISKS, GrowthSettings, grow_margin
from study.registration import PointRegistration
from study.specimens import structure_mask
from study.tables import t_interval
from study.volumes import LabelVolume

SETTINGS = GrowthSettings(registrations=1500, confidence=None, validation_registrations=1500)
STRUCTURES = ("chorda_tympani", "external_auditory_canal")


@pytest.fixture(scope="module")
def small():
    """Two structures of one bone at 0.4 mm."""
    return run_margin_table(["TB14"], (0.4,), SETTINGS, STRUCTURES, workers=1)


# Bones and volumes


def test_bones_are_names_or_folders(tmp_path):
    assert select_bones("CH05 CH01") == ["CH01", "CH05"]
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "labels.nrrd").write_bytes(b"")
    (tmp_path / "notes").mkdir()
    assert select_bones(str(tmp_path)) == [str(tmp_path / "a"), str(tmp_path / "b")]
    assert select_bones(str(tmp_path / "a")) == [str(tmp_path / "a")]
    with pytest.raises(InputError, match="expected a folder of a segmented bone"):
        select_bones(str(tmp_path / "notes"))
    with pytest.raises(InputError, match="XX01"):
        select_bones("XX01")


def test_real_folder_holds_the_real_bones():
    folder = real("temporal_bone")
    names = [Path(name).name for name in select_bones(str(folder))]
    assert names == sorted(names) and {"LT143", "LT151", "RT143"} <= set(names)


def test_voxels_of_nearly_the_size_are_taken_as_they_are():
    labels = np.zeros((8, 8, 8), np.uint8)
    labels[2:6, 2:6, 2:6] = 1
    volume = LabelVolume(labels, np.diag([0.384, 0.384, 0.384, 1.0]), {"air": 0, "nerve": 1})
    assert at_voxel_size(volume, 0.4) is volume
    finer, coarser = at_voxel_size(volume, 0.192), at_voxel_size(volume, 0.768)
    assert finer.shape == (16, 16, 16) and coarser.shape == (4, 4, 4)
    np.testing.assert_array_equal(coarser.labels, labels[::2, ::2, ::2])


def test_absent_and_tiny_structures_are_skipped_with_a_reason_at_every_voxel_size(monkeypatch):
    case = load_case("TB14")
    anatomy = case.anatomy
    labels = anatomy.labels.copy()
    labels[labels == anatomy.names["chorda_tympani"]] = anatomy.names["bone"]
    where = np.argwhere(labels == anatomy.names["internal_auditory_canal"])
    labels[tuple(where[5:].T)] = anatomy.names["bone"]  # five voxels, forty after upsampling
    cut = Case(case.name, case.planning, anatomy.with_labels(labels), case.approach, case.fiducials)
    assert reason_to_skip(cut, "facial_nerve") == ""
    assert reason_to_skip(cut, "chorda_tympani").startswith("absent")
    assert "5 voxels" in reason_to_skip(cut, "internal_auditory_canal")
    monkeypatch.setattr("study.experiments.margin_table.load_case", lambda name: cut)
    skipped = ("chorda_tympani", "internal_auditory_canal")
    found = run_margin_table(["x"], (0.4, 0.2), SETTINGS, skipped, workers=1)
    assert found.rows.empty
    assert found.skipped["structure"].tolist() == list(skipped)


# Rows


def test_rows_are_what_growing_a_margin_says(small):
    rows = small.rows.set_index(["structure", "variant"])
    assert len(rows) == len(STRUCTURES) * len(VARIANTS) and rows.index.is_unique
    case = load_case("TB14")
    mask = structure_mask(case.anatomy, "chorda_tympani")
    layer = ndimage.binary_dilation(mask, np.ones((3, 3, 3))) & ~mask
    for variant, shape in VARIANTS.items():
        row = rows.loc["chorda_tympani", variant]
        curve = small.curves["chorda_tympani", variant, 0.4]
        model = PointRegistration(case.fiducials)
        seed = [0, zlib.crc32(b"TB14")]
        margin = grow_margin(
            case.anatomy, mask, model, shape=shape, settings=SETTINGS, rng=seed, name="chorda_tympani"
        )
        assert row["safety_margin_volume_mm3"] == margin.volume_mm3
        assert row["final_damage_probability"] == margin.damage_risk <= 0.05
        assert row["mahalanobis_mean"] == pytest.approx(margin.shell_distances.mean())
        assert row["validated_risk"] == margin.validation.risk
        one_less = np.mean(margin.needs > margin.voxels - 1)
        assert row["risk_one_voxel_less"] == pytest.approx(one_less) and one_less > 0.05
        assert row["first_layer_mm3"] == pytest.approx(layer.sum() * case.anatomy.voxel_volume)
        assert row["first_layer_mm3"] <= row["safety_margin_volume_mm3"] + 1e-9
        pd.testing.assert_frame_equal(curve, margin.curve())


def test_a_bone_has_the_same_rows_whatever_else_is_asked_for(small):
    alone = run_margin_table(["TB14"], (0.4,), SETTINGS, STRUCTURES[1:], workers=1).rows
    same = small.rows[small.rows["structure"] == STRUCTURES[1]].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone.drop(columns="time_s"), same.drop(columns="time_s"))


def test_published_method_gives_rows_without_what_only_the_exact_one_knows():
    settings = GrowthSettings("published", 300, validation_registrations=0)
    rows = run_margin_table(["TB14"], (0.4,), settings, STRUCTURES[:1], workers=1).rows
    assert (rows["final_damage_probability"] <= 0.05).all()
    exact_only = ["risk_one_voxel_less", "sv_over_ut_at_equal_risk", "validated_risk"]
    assert rows[exact_only].isna().all(axis=None)
    assert {claim.text.split()[0] for claim in own_claims(rows)} == {"Margins"}


def test_unknown_structures_and_no_bone_are_refused():
    with pytest.raises(InputError, match="dura"):
        run_margin_table(["TB14"], structures=["dura"])
    with pytest.raises(InputError, match="at least one bone"):
        run_margin_table([])


# Volumes at the same risk


def test_volume_at_a_risk_is_the_smallest_that_satisfies_it():
    curve = pd.DataFrame({"volume_mm3": [0.0, 1.0, 3.0, 7.0], "risk": [1.0, 0.5, 0.1, 0.02]})
    for risk in (1.0, 0.7, 0.5, 0.3, 0.1, 0.05, 0.02):
        want = curve.loc[curve["risk"] <= risk, "volume_mm3"].min()
        assert volumes_at_risks(curve, np.array([risk]))[0] == want
    assert np.isnan(volumes_at_risks(curve, np.array([0.01]))[0])


def test_ratio_at_equal_risk_does_not_depend_on_where_growth_stopped():
    risk = np.geomspace(1, 1e-4, 300)
    smooth = pd.DataFrame({"volume_mm3": 10 - 3 * np.log(risk), "risk": risk})
    half = smooth.assign(volume_mm3=smooth["volume_mm3"] / 2)
    assert equal_risk_ratio(smooth, smooth, 0.01) == 1
    assert equal_risk_ratio(half, smooth, 0.01) == pytest.approx(0.5)
    # steps of a factor ten: final volumes would differ by one whole step or none
    coarse = smooth.iloc[::75]
    assert equal_risk_ratio(smooth, coarse, 0.01) == pytest.approx(1, abs=0.25)
    assert np.isnan(equal_risk_ratio(smooth.iloc[:3], smooth, 0.001))


# Means and layout


def test_means_have_t_intervals_and_stand_beside_the_printed_ones():
    rng = np.random.default_rng(0)
    which = printed_table()[["structure", "variant", "voxel_size_mm"]].drop_duplicates()
    rows = pd.concat([which.assign(**{q: rng.random(20) for q in QUANTITIES}) for _ in range(4)])
    table = measured_table(rows).set_index(["structure", "variant", "voxel_size_mm", "quantity"])
    entry = table.loc["sigmoid_sinus", "UT", 0.2, "mahalanobis_std"]
    values = rows.set_index(["structure", "variant", "voxel_size_mm"]).loc[("sigmoid_sinus", "UT", 0.2)]
    interval = t_interval(values["mahalanobis_std"])
    assert entry["measured"] == pytest.approx(interval.mean)
    assert entry["measured_plus_minus"] == pytest.approx(interval.half_width)
    assert (entry["printed"], entry["printed_plus_minus"], entry["n"]) == (1.04, 0.14, 4)
    single = measured_table(rows.iloc[:20])
    assert single["measured"].notna().all() and single["measured_plus_minus"].isna().all()
    shown = beside_each_other(measured_table(rows))
    assert shown.shape == (5 * len(QUANTITIES) * 2, 4)
    assert shown.loc[("facial_nerve", "mahalanobis_mean", "printed"), "SV 0.4 mm"] == "7.70 ± 0.49"


def test_times_are_minutes_a_bone_for_all_structures(small):
    times = times_table(small.rows).set_index(["variant", "voxel_size_mm"])
    spent = small.rows.loc[small.rows["variant"] == "SV", "time_s"].sum() / 60
    assert times.loc[("SV", 0.4), "measured_min"] == pytest.approx(spent)
    assert np.isnan(times.loc[("SV", 0.2), "measured_min"])
    assert structures_table(small.rows)["n"].tolist() == [1, 1]


# Claims


def verdicts(claims):
    return [claim.holds for claim in claims]


def test_claims_about_the_printed_means_are_those_of_the_audit():
    claims = table_claims(printed_means(), "printed")
    # I10 at 0.4 and 0.2 mm; C3 twice; volumes; I12; I11 and the gap to the overall risk; C3; I13
    assert verdicts(claims) == [False, True, True, True, True, False, False, True, True, False]
    assert "in 2 of 5 structures" in claims[0].evidence and "chorda tympani +44.7" in claims[0].evidence
    assert "in 9 of 10" in claims[5].evidence
    assert "in 11 of 20" in claims[6].evidence and "3e-04 at 0.2 mm" in claims[6].evidence


def test_every_claim_about_means_can_fail():
    means = printed_means().sort_index()
    at = ("chorda_tympani", "SV", 0.2)
    for column, value, expected in (
        ("safety_margin_volume_mm3", 200.0, {1, 4}),
        ("mahalanobis_std", 3.0, {2, 3}),
        ("final_damage_probability", 0.051, {8}),
        ("mean_point_risk", 0.04, {7}),
    ):
        changed = means.copy()
        changed.loc[at, column] = value
        before, after = (verdicts(table_claims(m, "printed")) for m in (means, changed))
        assert {k for k, (a, b) in enumerate(zip(before, after, strict=True)) if a and not b} == expected
    few = table_claims(means.xs(0.4, level="voxel_size_mm", drop_level=False), "printed")
    assert not any("upsampling" in claim.text for claim in few)
    with pytest.raises(InputError, match="at least one structure"):
        table_claims(means.iloc[:0], "printed")


def test_own_claims_are_decided_by_the_rows(small):
    rows = small.rows.copy()
    rows["sv_over_ut_at_equal_risk"] = 0.9
    rows["risk_one_voxel_less"] = rows["final_damage_probability"]
    rows["first_layer_mm3"] = 0.5 * rows["safety_margin_volume_mm3"]
    rows["validated_risk"], rows["validated_low"] = 0.04, 0.03
    assert verdicts(own_claims(rows)) == [True] * 4
    rows.loc[0, "sv_over_ut_at_equal_risk"] = 1.3
    rows.loc[0, "risk_one_voxel_less"] = rows.loc[0, "final_damage_probability"] + 0.01
    rows.loc[0, "first_layer_mm3"] = rows.loc[0, "safety_margin_volume_mm3"]
    rows.loc[0, "validated_low"] = 0.0501
    assert verdicts(own_claims(rows)) == [False] * 4


def test_claims_about_our_rows_speak_of_the_structures_they_have(small):
    claims = table_claims(measured_means(small.rows), "measured", SETTINGS.registrations)
    assert all(claim.where == "measured" for claim in claims)
    assert "of 2 structures" in claims[0].evidence
    assert set(small.rows["acceptable_risk"]) == {ACCEPTABLE_RISKS[s] for s in STRUCTURES}
