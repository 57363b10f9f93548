"""Tables A.1, A.2 and 2.2: shape of the printed result against ours, column by column, with reasons.

The bones differ (ours are synthetic, fitted to the printed target volume alone), so what is compared is
the set: eight of the 36 names, spread over the catalogue.
"""

import numpy as np
import pytest

from study import published
from study.appendix import PRINTED, run_appendix, select_specimens
from study.appendix_claims import bone_counted_cm3

NAMES = select_specimens("8")


@pytest.fixture(scope="module")
def ours():
    return {strategy: run_appendix(NAMES, strategy, 4) for strategy in ("zigzag", "3d")}


@pytest.fixture(scope="module")
def printed():
    return {
        strategy: published.corrected(PRINTED[strategy, 4]).set_index("specimen").loc[NAMES]
        for strategy in ("zigzag", "3d")
    }


#: strategy, column, lowest and highest ratio of our mean to the printed one (in true units), reason
RATIOS = [
    # fitted: the one column that is an input, rounded to two digits in print
    ("zigzag", "modified_initial_target_cm3", 0.98, 1.02),
    ("3d", "modified_initial_target_cm3", 0.98, 1.02),
    # The zigzag's pitch is not printed. Ours is 3; at 2 and 5 voxels our own path is 1.51 and 0.76 times
    # as long (sensitivity table of plan_one_specimen), so the print may be anywhere between.
    ("zigzag", "predicted_path_length_mm", 1 / 1.51, 1 / 0.76),
    # The 3-D path hangs on the target boundary, of which the text gives two meanings: 26-connected
    # makes ours 1.20 times as long. A twentieth beyond either for the bones being others.
    ("3d", "predicted_path_length_mm", 1 / 1.25, 1.05),
    # Of the zigzag's steps those between rows cut nothing, whatever the pitch.
    ("zigzag", "steps_in_contact_over_path_length_ratio", 0.85, 1.15),
    # A step on a row takes off one row pitch times one layer pitch: 9 voxels at ours, 4 to 16 at 2 to 4.
    ("zigzag", "average_voxels_per_step_in_contact_voxels", 0.6, 1.5),
    # The feed constant is fitted to this mean over all 36.
    ("zigzag", "average_milling_speed_mm_per_s", 0.97, 1.03),
]


@pytest.mark.parametrize(("strategy", "column", "low", "high"), RATIOS)
def test_mean_is_of_the_printed_size(ours, printed, strategy, column, low, high):
    ratio = ours[strategy][column].mean() / printed[strategy][column].mean()
    assert low <= ratio <= high


@pytest.mark.parametrize("strategy", ["zigzag", "3d"])
@pytest.mark.parametrize("column", ["predicted_path_length_mm", "predicted_milling_time_s"])
def test_length_and_time_grow_with_the_volume_as_printed(ours, printed, strategy, column):
    for rows in (ours[strategy], printed[strategy]):
        volume = rows["modified_initial_target_cm3"]
        assert np.corrcoef(volume, rows[column])[0, 1] > 0.9


def test_three_d_path_is_shorter_on_average_as_printed(ours, printed):
    for rows in (ours, printed):
        shorter = rows["zigzag"]["predicted_path_length_mm"] - rows["3d"]["predicted_path_length_mm"]
        assert shorter.mean() > 0


def test_rounding_saves_more_of_the_three_d_path_as_printed(ours, printed):
    for rows in (ours, printed):
        saved = {
            strategy: 1
            - rows[strategy]["milling_path_length_mm"] / rows[strategy]["predicted_path_length_mm"]
            for strategy in ("zigzag", "3d")
        }
        assert saved["3d"].mean() > saved["zigzag"].mean() >= 0


def test_no_more_target_is_left_than_printed(ours, printed):
    column = "modified_final_over_initial_ratio"
    for strategy in ("zigzag", "3d"):
        assert ours[strategy][column].max() <= 1e-3
        assert ours[strategy][column].mean() <= printed[strategy][column].mean()


def test_three_d_cuts_less_often_and_more_at_a_time_as_printed(ours, printed):
    for rows in (ours, printed):
        contact = "steps_in_contact_over_path_length_ratio"
        voxels = "average_voxels_per_step_in_contact_voxels"
        assert (rows["3d"][contact] < rows["zigzag"][contact]).all()
        assert (rows["3d"][voxels] > rows["zigzag"][voxels]).all()


def test_contact_columns_add_up_to_the_same_bone_here_and_not_in_print(ours, printed):
    """Finding I1: both planners remove the same bone; the printed 3-D columns count half of it."""
    here = (bone_counted_cm3(ours["3d"]) / bone_counted_cm3(ours["zigzag"])).mean()
    there = (bone_counted_cm3(printed["3d"]) / bone_counted_cm3(printed["zigzag"])).mean()
    assert 0.9 < here < 1.15  # counted per step of unequal length, so not exactly one
    assert there < 0.7


def test_every_row_was_replayed(ours):
    for rows in ours.values():
        assert list(rows.index) == NAMES
        assert rows["verified"].all()
