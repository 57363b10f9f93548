import pytest

from study import published
from study.errors import InputError
from study.paths import data_path

ROWS = {
    "2.2": 8,
    "2.3": 15,
    "3.2": 20,
    "3.2 time": 4,
    "4.2": 8,
    **{f"A.{k}": 36 for k in range(1, 5)},
    **{f"B.{k}": 8 for k in range(1, 10)},
    "Baron 1": 4,
    "Baron absolute accuracy": 2,
}


def test_every_table_has_its_rows():
    assert {name: len(published.table(name)) for name in published.tables()} == ROWS
    assert len(published.appendix_b()) == 72


@pytest.mark.parametrize("name", ["A.1", "A.2", "A.3", "A.4"])
def test_appendix_a_lists_the_specimens_in_printed_order(name):
    expected = [f"CH{k:02d}" for k in range(1, 20)] + [f"TB{k:02d}" for k in range(1, 18)]
    assert published.table(name)["specimen"].tolist() == expected


@pytest.mark.parametrize(
    ("name", "row", "column", "value"),
    [
        ("2.2", 2, "predicted_path_length_mm", 656),
        ("2.3", 12, "true_milling_time_s", 724),
        ("3.2", 4, "safety_margin_volume_mm3_mean", 69.17),
        ("3.2 time", 1, "time_min_plus_minus", 11.46),
        ("4.2", 5, "margin_volume_cm3", 1.3e5),
        ("A.1", 32, "modified_final_over_initial_ratio", 0.25),
        ("A.2", 0, "milling_path_length_mm", 426),
        ("A.3", 18, "modified_initial_target_cm3", 4.38),
        ("A.4", 35, "simulation_time_s", 78208),
        ("B.8", 7, "final_damage_probability", 1.5e-2),
        ("Baron 1", 3, "confidence_999_major_axis_mm", 0.408),
        ("Baron absolute accuracy", 0, "mean_mm", 0.62),
    ],
)
def test_spot_values(name, row, column, value):
    assert published.table(name).loc[row, column] == value


def test_as_printed_keeps_the_digits():
    assert published.table("B.1", as_printed=True).loc[0, "mahalanobis_std"] == "0.40"
    assert (
        published.summary("A.1", as_printed=True).loc["mean", "modified_final_over_initial_ratio"]
        == "1.3e-02"
    )
    # nothing is printed for the robot's columns at 5 DOF
    assert published.table("2.2", as_printed=True).loc[4, "milling_path_length_mm"] == ""
    assert published.table("2.2")["milling_path_length_mm"].isna().sum() == 4


def test_summaries():
    assert published.summary("A.2").loc["plus_minus", "predicted_milling_time_s"] == 438
    assert published.summary("2.3").loc[("3d", "mean"), "true_milling_time_s"] == 1191
    with pytest.raises(InputError, match=r"2\.3, A\.1, A\.2, A\.3, A\.4"):
        published.summary("2.2")


def test_corrected_changes_only_units_that_are_certain():
    printed, corrected = published.table("A.2"), published.corrected("A.2")
    lengths = ["predicted_path_length_mm", "milling_path_length_mm", "path_length_over_volume_mm_per_cm3"]
    for column in printed:
        if column in lengths:
            assert (corrected[column] == 10 * printed[column]).all()
        else:
            assert (corrected[column] == printed[column]).all()
    assert published.table("A.2").equals(printed)  # the printed table is untouched


@pytest.mark.parametrize("name", ["4.2", "B.7"])
def test_margin_volumes_become_mm3(name):
    corrected = published.corrected(name)
    assert "margin_volume_cm3" not in corrected
    assert (corrected["margin_volume_mm3"] == published.table(name)["margin_volume_cm3"]).all()


@pytest.mark.parametrize("name", ["2.3", "3.2", "Baron 1"])
def test_nothing_to_correct(name):
    assert published.corrected(name).equals(published.table(name))


def test_speed_follows_from_corrected_lengths():
    """The correction is right if the corrected length over the time is the printed speed."""
    rows = published.corrected("A.1")
    speed = rows["milling_path_length_mm"] / rows["predicted_milling_time_s"]
    assert (abs(speed - rows["average_milling_speed_mm_per_s"]) < 0.06).all()


def test_tables_are_fresh_copies():
    rows = published.table("A.1")
    rows.loc[0, "specimen"] = "gone"
    assert published.table("A.1").loc[0, "specimen"] == "CH01"


def test_faults():
    assert {"E1", "E2"} <= {fault.id for fault in published.faults("A.2")}
    assert {"E4"} <= {fault.id for fault in published.faults("A.3")}
    assert published.faults("3.2 time") == []
    every = published.faults()
    assert [fault.id for fault in every[:6]] == [f"E{k}" for k in range(1, 7)]
    assert len(every) == 31
    assert all(set(fault.tables) <= set(published.tables()) for fault in every)


@pytest.mark.parametrize("read", [published.table, published.corrected, published.faults, published.codebook])
def test_unknown_names_list_what_exists(read):
    with pytest.raises(InputError, match=r"'A\.5'.*2\.2.*A\.4.*Baron 1"):
        read("A.5")


def test_codebook_covers_every_column():
    book = published.codebook()
    assert not book.duplicated(["file", "column"]).any()
    assert (book["meaning"] != "").all()
    for name in published.tables():
        assert published.codebook(name)["column"].tolist() == published.table(name).columns.tolist()
    files = {path.name for path in data_path("published").glob("*.csv")} - {"codebook.csv", "findings.csv"}
    assert set(book["file"]) == files


def test_parameters():
    assert published.parameter("fle_rms").value == 0.176
    assert published.parameter("fle_rms").section == "3.3.1"
    assert published.parameter("tracker_rate", "baron_2010").unit == "Hz"
    assert published.parameter("T_r").value is None
    assert published.parameter("n_r", section="4.3.1").value == 5000
    assert len(published.parameters()) == 152


def test_parameter_errors():
    with pytest.raises(InputError, match=r"sections 3\.3\.1, 4\.3\.1"):
        published.parameter("n_r")
    with pytest.raises(InputError, match=r"there are: .*fle_rms"):
        published.parameter("fle")
    with pytest.raises(InputError, match="baron_2010, siebold_2021"):
        published.parameter("fle_rms", "zheng")
