"""Tables 4.2 and B.1 to B.9: shape of the printed result against ours, with tolerances and reasons.

The tumours differ: the printed ones are known by their margins alone, ours are fitted to nothing in these
tables. Two kidneys and three of the nine starts, with few registrations: what is tested are sizes and order.
"""

import numpy as np
import pandas as pd
import pytest

from study.experiments.kidney_claims import printed_rows
from study.experiments.kidney_margins import run_kidney_margins
from study.experiments.kidney_scaling import fit_power_law

KIDNEYS = ["K1", "K4"]
#: Position and rotation errors, run, registrations.
GROWN = (
    ([5.0, 2.5], [5.0], "published", 300),
    ([5.0], [2.5], "published", 300),
    ([5.0, 2.5], [5.0], "converged", 150),
)
WHICH = ["kidney", "pos_std_mm", "rot_std_deg"]
VOLUME = "margin_volume_mm3"


@pytest.fixture(scope="module")
def rows():
    return pd.concat(
        run_kidney_margins(KIDNEYS, positions, rotations, [run], count, 0, 100, confidence=None).rows
        for positions, rotations, run, count in GROWN
    )


@pytest.fixture(scope="module")
def published(rows):
    return rows[rows["run"] == "published"]


def shapes(rows, column):
    return rows.pivot_table(column, WHICH, "variant")


def test_loosely_stopped_margins_are_of_the_printed_size(published):
    """In mm^3, so that the printed cm^3 are excluded by a factor of a thousand (finding E5).

    Between the smallest and the largest printed margin of the same start and shape; twice as much either way,
    because four printed tumours do not span what tumours there are.
    """
    printed = printed_rows().groupby(["table", "variant"])[VOLUME].agg(["min", "max"])
    for row in published.itertuples():
        low, high = printed.loc[(row.table, row.variant)]
        assert low / 2 < row.margin_volume_mm3 < 2 * high


def test_spatially_varying_margins_are_smaller_as_printed(published):
    """36 of 36 in print, 0.30 to 0.72 of the constant one, median 0.54.

    Ours are smaller in each case. The median may be off by a third: ours is of six margins, and the printed
    ratios of one tumour lie as far from it (0.35 of tumour 1).
    """
    pairs = shapes(published, VOLUME)
    ratio = pairs["SV"] / pairs["CT"]
    assert (ratio < 1).all()
    assert 0.54 * 2 / 3 < ratio.median() < 0.54 * 4 / 3


def test_distances_of_the_final_shell_scatter_less_and_are_smaller_for_spatially_varying_margins_as_printed(
    published,
):
    for column in ("mahalanobis_mean", "mahalanobis_std"):
        assert (shapes(published, column)["SV"] < shapes(published, column)["CT"]).all()


def test_mean_distance_of_the_final_shell_is_of_the_printed_size(published):
    """In standard deviations of the error, so that its size cancels: print has 1.8 to 2.4 everywhere.

    Up to twice as much: the farthest hundredth of registrations decides, and how many standard deviations
    that is depends on the tails of the fits, which the text's stopping rule, not printed, makes.
    """
    printed = printed_rows()
    printed = printed.loc[printed["variant"] == "SV", "mahalanobis_mean"]
    ours = published.loc[published["variant"] == "SV", "mahalanobis_mean"]
    assert ours.between(printed.min(), 2 * printed.max()).all()


def test_position_matters_and_rotation_does_not_as_printed(published):
    """Print: exponents 0.77 ± 0.16 and 1.07 ± 0.22 for position, 0.07 ± 0.16 and -0.03 ± 0.22 for rotation.

    Ours for rotation has to lie in the printed interval about none. For position ours may be up to twice the
    printed one and not less than half: the power with which a volume follows the scatter grows with the
    margin's thickness over the tumour's size (1 if thin, 3 if thick), and the printed tumours' sizes are not
    known.
    """
    for variant, position, rotation_half in (("SV", 0.77, 0.16), ("CT", 1.07, 0.22)):
        law = fit_power_law(published[published["variant"] == variant], VOLUME, group="kidney")
        assert position / 2 < law.exponents["pos_std_mm"].mean < 2 * position
        assert abs(law.exponents["rot_std_deg"].mean) < rotation_half
        assert law.difference.mean > 0.5


def test_converged_fits_scatter_less_and_need_less(rows):
    """What the printed tables do not say: at every start, and from the largest by a quarter at least.

    Volumes at the largest start alone: the growth differs too, and the printed one ends with too small a
    margin (risk on fresh registrations), which at small errors is about as much.
    """
    rows = rows[rows["rot_std_deg"] == 5.0]
    ratio = rows.pivot_table("scatter_mm", WHICH, "stop").eval("converged / loose")
    assert (ratio < 1).all() and (ratio.xs(5.0, level="pos_std_mm") < 0.75).all()
    for _, part in rows[rows["pos_std_mm"] == 5.0].groupby("variant"):
        volumes = part.pivot_table(VOLUME, WHICH, "run")
        assert (volumes["converged"] < volumes["published"]).all()
    ended = rows.groupby("stop")["converged_pct"]
    assert ended.min()["converged"] > 99 and ended.max()["loose"] < 50


def test_times_are_seconds_and_not_the_printed_hour(rows):
    """The printed 5 to 129 minutes were spent on 44 cores with N_r = 5000, ours are for 300 at most.

    That is a sixteenth of the registrations; a tenth of the printed median leaves room for a busy machine.
    """
    assert rows["time_min"].max() < 0.1 * printed_rows()["time_min"].median()
    assert np.isfinite(rows["time_min"]).all() and (rows["time_min"] > 0).all()
