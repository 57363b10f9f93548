"""Table 3.2: shape of the printed result against ours, with tolerances and reasons.

The bones differ: ours are synthetic and fitted to nothing in this table. Two of the five of the notebook.
"""

import numpy as np
import pytest

from study.experiments.margin_claims import measured_means, printed_means, table_claims
from study.experiments.margin_table import run_margin_table
from study.margins import ACCEPTABLE_RISKS, GrowthSettings

VOLUME, RISK, DISTANCE, SPREAD = (
    "safety_margin_volume_mm3",
    "final_damage_probability",
    "mahalanobis_mean",
    "mahalanobis_std",
)


@pytest.fixture(scope="module")
def rows():
    settings = GrowthSettings(validation_registrations=0)
    return run_margin_table(["CH01", "CH05"], settings=settings, workers=1).rows


@pytest.fixture(scope="module")
def ours(rows):
    return measured_means(rows)


@pytest.fixture(scope="module")
def printed():
    return printed_means()


def test_mean_distance_of_the_final_shell_is_of_the_printed_size(ours, printed):
    """In standard deviations of the error, so that most of anatomy and fiducials cancels.

    A quarter either way: the widest printed interval is a fifth of its mean (7.57 ± 1.55), and the exact
    margin's 95 % confidence takes a little more than the printed stop.
    """
    ratio = ours[DISTANCE] / printed[DISTANCE]
    assert ratio.between(0.75, 1.25).all()
    assert abs(ratio.mean() - 1) < 0.1  # of twenty entries, errors of single ones even out


def test_scatter_of_distances_is_of_the_printed_size(ours, printed):
    """Printed SDs have intervals of up to a third of themselves, ours of two bones as well."""
    ratio = ours[SPREAD] / printed[SPREAD]
    assert ratio.between(0.6, 1.7).all()


def test_facial_nerve_has_a_margin_of_the_printed_volume(ours, printed):
    """The one structure of alike extent; its length in the image is not printed and differs by a third."""
    ratio = (ours[VOLUME] / printed[VOLUME]).xs("facial_nerve", level="structure")
    assert ratio.between(2 / 3, 1.5).all()


@pytest.mark.parametrize("structure", ["chorda_tympani", "external_auditory_canal"])
def test_spatially_varying_margins_are_larger_at_0_4_mm_and_smaller_at_0_2_mm_as_printed(
    ours, printed, structure
):
    """Finding I10, the two structures in which it is large: no claim of the text, but of its table."""
    for means in (ours, printed):
        at = means[VOLUME].xs(structure, level="structure")
        assert at["SV", 0.4] > 1.05 * at["UT", 0.4]
        assert at["SV", 0.2] < at["UT", 0.2]


def test_the_anomaly_is_there_at_the_same_risk_too(rows):
    """So it is no luck of where growth stopped."""
    sv = rows[rows["variant"] == "SV"]
    ratio = np.log(sv.set_index(["structure", "voxel_size_mm"])["sv_over_ut_at_equal_risk"])
    mean = np.exp(ratio.groupby(level=[0, 1]).mean())
    assert mean["external_auditory_canal", 0.4] > 1.05
    assert (mean.xs(0.2, level="voxel_size_mm") < 1).all()


def test_upsampled_spatially_varying_margins_are_smaller_in_all_structures_as_printed(ours, printed):
    for means in (ours, printed):
        volumes = means[VOLUME].xs(0.2, level="voxel_size_mm")
        assert (volumes.xs("SV", level="variant") < volumes.xs("UT", level="variant")).all()


def test_distances_scatter_less_for_spatially_varying_margins_and_after_upsampling_as_printed(ours, printed):
    for means in (ours, printed):
        spread = means[SPREAD]
        assert (spread.xs("SV", level="variant") < spread.xs("UT", level="variant")).all()
        fine, coarse = (spread.xs(size, level="voxel_size_mm") for size in (0.2, 0.4))
        assert (fine < coarse).all()


def test_upsampling_makes_margins_smaller_as_printed(ours, printed):
    for means in (ours, printed):
        fine, coarse = (means[VOLUME].xs(size, level="voxel_size_mm") for size in (0.2, 0.4))
        assert (fine < coarse).all()


def test_final_risks_are_acceptable_in_every_bone(rows, printed):
    assert (rows[RISK] <= rows["acceptable_risk"]).all()
    acceptable = printed.index.get_level_values("structure").map(ACCEPTABLE_RISKS)
    assert (printed[RISK] <= acceptable).all()


@pytest.mark.parametrize("structure", ["chorda_tympani", "external_auditory_canal"])
def test_upsampling_brings_the_risks_of_coarse_structures_near_the_acceptable_as_printed(
    ours, printed, structure
):
    """Finding I12: true where the acceptable risk is large (0.05), from below a half to above a half."""
    for means in (ours, printed):
        share = means[RISK].xs(structure, level="structure") / ACCEPTABLE_RISKS[structure]
        assert share.xs(0.4, level="voxel_size_mm").max() < 0.5
        assert share.xs(0.2, level="voxel_size_mm").min() > 0.5


def test_point_risks_are_not_1e_7_at_0_2_mm_here_nor_in_print(ours, printed):
    """Finding I11."""
    for means in (ours, printed):
        assert means["mean_point_risk"].xs(0.2, level="voxel_size_mm").max() > 1e-4


def test_the_same_claims_hold_or_fail_but_for_the_one_that_hangs_on_one_mean(ours, printed):
    """Printed risks come closer after upsampling in 9 of 10 (sigmoid sinus UT does not); ours may in all."""
    here, there = (table_claims(means, "measured") for means in (ours, printed))
    differ = [a.text for a, b in zip(here, there, strict=True) if a.holds != b.holds]
    assert set(differ) <= {"Final risks are closer to the acceptable ones after upsampling"}
