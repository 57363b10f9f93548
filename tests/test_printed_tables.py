"""Tables A.1 to A.4 and 2.2: shape of the printed result against ours, column by column, with reasons.

The bones differ (ours are synthetic, fitted to the printed target volume alone), so what is compared is
the set: eight of the 36 names, spread over the catalogue.
"""

import numpy as np
import pandas as pd
import pytest

from study import published
from study.experiments.appendix import PRINTED, run_appendix, select_specimens
from study.experiments.appendix_claims import bone_counted_cm3, strategy_claims

NAMES = select_specimens("8")


@pytest.fixture(scope="module")
def measured():
    """Rows of all four tables, bone by bone: so each is built once, not for every table again."""
    rows = {(strategy, dof): [] for strategy in ("zigzag", "3d") for dof in (4, 5)}
    for name in NAMES:
        for (strategy, dof), table in rows.items():
            table.append(run_appendix([name], strategy, dof, workers=1))
    return {key: pd.concat(table) for key, table in rows.items()}


@pytest.fixture(scope="module")
def ours(measured):
    return {strategy: measured[strategy, 4] for strategy in ("zigzag", "3d")}


@pytest.fixture(scope="module")
def ours_5(measured):
    return {strategy: measured[strategy, 5] for strategy in ("zigzag", "3d")}


def printed_rows(dof):
    return {
        strategy: published.corrected(PRINTED[strategy, dof]).set_index("specimen").loc[NAMES]
        for strategy in ("zigzag", "3d")
    }


@pytest.fixture(scope="module")
def printed():
    return printed_rows(4)


@pytest.fixture(scope="module")
def printed_5():
    assert not set(NAMES) & set(published.OTHER_BONES)  # those rows are not the bones of A.1 and A.2
    return printed_rows(5)


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


# 5 degrees of freedom: tables A.3 and A.4, lower half of table 2.2

#: As `RATIOS`.
RATIOS_5 = [
    # Fitted to A.1. A.3 and A.4 start from as much on 18 of the 33 bones that are the same, from less on
    # 15, 3.5 % less on average: their planner gave up more at the start, ours gives up nothing.
    ("zigzag", "modified_initial_target_cm3", 0.98, 1.07),
    ("3d", "modified_initial_target_cm3", 0.98, 1.07),
    # As with 4 DOF (pitch, boundary), and up to those 3.5 % more to visit.
    ("zigzag", "predicted_path_length_mm", 1 / 1.51, 1.035 / 0.76),
    ("3d", "predicted_path_length_mm", 1 / 1.25, 1.05 * 1.035),
    # As with 4 DOF; printed with one digit only, 0.7 for 0.65 to 0.75.
    ("zigzag", "steps_in_contact_over_path_length_ratio", 0.85 * 0.65 / 0.7, 1.15 * 0.75 / 0.7),
    ("zigzag", "average_voxels_per_step_in_contact_voxels", 0.6, 1.5),
]


@pytest.mark.parametrize(("strategy", "column", "low", "high"), RATIOS_5)
def test_mean_with_5_dof_is_of_the_printed_size(ours_5, printed_5, strategy, column, low, high):
    ratio = ours_5[strategy][column].mean() / printed_5[strategy][column].mean()
    assert low <= ratio <= high


def test_columns_of_the_robot_are_empty_with_5_dof_as_printed(ours_5, printed_5):
    for rows in (ours_5, printed_5):
        assert not {"milling_path_length_mm", "predicted_milling_time_s"} & set(rows["3d"].columns)


@pytest.mark.parametrize("strategy", ["zigzag", "3d"])
def test_paths_of_4_and_5_dof_are_alike_as_printed(ours, ours_5, printed, printed_5, strategy):
    """Text: 0.5 % and 2.3 % apart, "fairly close"; 5 % is half of what the 3-D planner saves."""
    for four, five in ((ours, ours_5), (printed, printed_5)):
        lengths = [rows[strategy]["predicted_path_length_mm"].mean() for rows in (four, five)]
        assert abs(lengths[1] / lengths[0] - 1) < 0.05


def test_with_5_dof_the_three_d_path_is_shorter_and_cuts_less_often_and_more_as_printed(ours_5, printed_5):
    for rows in (ours_5, printed_5):
        shorter = rows["zigzag"]["predicted_path_length_mm"] - rows["3d"]["predicted_path_length_mm"]
        assert shorter.mean() > 0
        contact = "steps_in_contact_over_path_length_ratio"
        voxels = "average_voxels_per_step_in_contact_voxels"
        assert (rows["3d"][contact] < rows["zigzag"][contact]).all()
        assert (rows["3d"][voxels] > rows["zigzag"][voxels]).all()


@pytest.mark.parametrize("strategy", ["zigzag", "3d"])
def test_5_dof_leaves_no_more_than_4_here_and_more_in_print(ours, ours_5, printed, printed_5, strategy):
    """What 2.5.1 expected and did not find; the whole cone is searched here, a window of 5 degrees there."""
    left, start = "modified_final_over_initial_ratio", "modified_initial_target_cm3"
    assert (ours_5[strategy][left] <= ours[strategy][left]).all()
    assert (ours_5[strategy][start] >= ours[strategy][start]).all()  # nothing given up instead
    assert printed_5[strategy][left].mean() > printed[strategy][left].mean()
    assert (printed_5[strategy][start] <= printed[strategy][start]).all()


def test_planning_with_5_dof_takes_seconds_and_not_hours(ours_5, printed_5):
    column = "simulation_time_s"
    assert printed_5["3d"][column].min() > 3600
    assert ours_5["3d"][column].mean() < printed_5["3d"][column].mean() / 1000


def test_every_row_with_5_dof_was_replayed(ours_5):
    for rows in ours_5.values():
        assert list(rows.index) == NAMES
        assert rows["verified"].all()


@pytest.mark.parametrize("strategy", ["zigzag", "3d"])
def test_what_can_be_said_of_one_planner_holds_with_4_and_5_dof(ours, ours_5, printed, printed_5, strategy):
    for rows, beside, replayed in ((ours, printed, "rounded path"), (ours_5, printed_5, "No plan cuts")):
        claims = strategy_claims(rows[strategy], beside[strategy])
        assert all(claim.holds for claim in claims), [claim.text for claim in claims if not claim.holds]
        assert replayed in claims[0].text
