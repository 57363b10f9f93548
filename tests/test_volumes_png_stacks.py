"""Colour-coded slices: order, colours, sums of colours, geometry."""

import tempfile
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from real_data import real
from scipy import ndimage
from volume_cases import random_affine

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.volumes import (
    ColourTable,
    LabelVolume,
    read_colour_table,
    read_png_stack,
    read_volume,
    write_png_stack,
)
from study.volumes.png_stacks import sorted_slices

TABLE = ColourTable(("bone", "nerve", "dura"), (1, 10, 3), ((255, 249, 219), (244, 214, 49), (110, 184, 209)))
PRIORITY = ("nerve", "dura", "bone")
# The colours of the public temporal bones, from the README beside the real data.
REAL_COLOURS = """Bone 255 249 219, Malleus 233 0 255, Incus 0 255 149, Stapes 63 0 255,
Bony_Labyrinth 91 123 91, IAC 244 142 52, Superior_Vestibular_Nerve 255 191 135,
Inferior_Vestibular_Nerve 121 70 24,
Cochlear_Nerve 219 244 52, Facial_Nerve 244 214 49, Chorda_Tympani 151 131 29, ICA 216 100 79,
Sinus_Dura 110 184 209, Vestibular_Aqueduct 91 98 123, TMJ 100 0 0, EAC 255 225 214"""
REAL_RANKS = """Chorda_Tympani Facial_Nerve Stapes Malleus Incus Cochlear_Nerve Superior_Vestibular_Nerve
Inferior_Vestibular_Nerve Vestibular_Aqueduct Bony_Labyrinth IAC ICA EAC Sinus_Dura TMJ Bone"""
REAL_PRIORITY = REAL_RANKS.split()


def real_table():
    rows = [row.split() for row in REAL_COLOURS.split(",")]
    return ColourTable(
        tuple(row[0] for row in rows),
        tuple(range(1, len(rows) + 1)),
        tuple(tuple(int(part) for part in row[1:]) for row in rows),
    )


def write_slices(folder, rgba, name="plane00{}.png"):
    """Write (rows, columns, n, 4) slices, unpadded numbers."""
    for k in range(rgba.shape[2]):
        Image.fromarray(np.ascontiguousarray(rgba[:, :, k])).save(folder / name.format(k))


def painted(labels, table=TABLE):
    rgba = np.zeros((*labels.shape, 4), np.uint8)
    for label, colour in zip(table.labels, table.colours, strict=True):
        rgba[labels == label] = (*colour, 255)
    return rgba


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32))
def test_round_trip(seed):
    rng = np.random.default_rng(seed)
    labels = rng.choice([0, 1, 3, 10], (*rng.integers(1, 9, 2), rng.integers(1, 13))).astype(np.uint8)
    names = {"air": 0, "bone": 1, "nerve": 10, "dura": 3}
    volume = LabelVolume(labels, random_affine(rng), names)
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "new" / "slices"
        write_png_stack(volume, target, TABLE)
        back = read_png_stack(
            target, TABLE, volume.spacing, volume.affine[:3, 3], directions=volume.directions
        )
        assert len(list(target.iterdir())) == labels.shape[2]
        assert list(target.parent.iterdir()) == [target]
    assert (back.labels == labels).all()
    assert back.names == names
    assert back.affine == pytest.approx(volume.affine, abs=1e-9)


def test_slices_are_in_the_order_of_their_numbers(tmp_path):
    labels = np.zeros((3, 4, 105), np.uint8)
    labels[1, 2, np.arange(0, 105, 7)] = 10
    labels[0, 0, 100:] = 3
    write_slices(tmp_path, painted(labels))
    volume = read_png_stack(tmp_path, TABLE, (1, 2, 3))
    assert (volume.labels == labels).all()  # rows are i, columns j
    assert volume.spacing == pytest.approx([1, 2, 3])


def numbers_of(folder, names):
    for name in names:
        (folder / name).touch()
    return [path.name for path in sorted_slices(folder)]


@pytest.mark.parametrize(
    "names",
    [
        ["plane000.png", "plane001.png", "plane002.png"],
        [f"plane00{n}.png" for n in range(12)],
        [f"{n}.PNG" for n in range(9, 12)],
        [f"scan2_slice{n}_mask.png" for n in range(98, 103)],
        ["only.png"],
    ],
)
def test_sorting(tmp_path, names):
    (tmp_path / "notes.txt").touch()
    (tmp_path / ".hidden.png").touch()
    assert numbers_of(tmp_path, reversed(names)) == names


@pytest.mark.parametrize(
    ("names", "says"),
    [
        ([], "got none"),
        (["a1.png", "a2.png", "a4.png"], "missing, such as [3]"),
        (["a1.png", "a01.png"], "one slice 1"),
        (["a1.png", "b1.png", "overview.png"], "slice number"),
        (["a1.png", "a2_mask.png"], "one series"),
    ],
)
def test_slices_that_are_no_series(tmp_path, names, says):
    with pytest.raises(FileFormatError) as caught:
        numbers_of(tmp_path, names)
    assert says in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_transparent_is_background_whatever_its_colour(tmp_path):
    rgba = painted(np.ones((2, 2, 2), np.uint8))
    rgba[0, 0, 0] = (9, 9, 9, 0)
    write_slices(tmp_path, rgba)
    volume = read_png_stack(tmp_path, TABLE, (1, 1, 1))
    assert volume.labels.ravel().tolist() == [0] + [1] * 7
    assert volume.names == {"air": 0, "bone": 1, "nerve": 10, "dura": 3}


def test_rgb_slices_and_a_colour_for_air(tmp_path):
    table = ColourTable(("outside", "bone"), (0, 1), ((0, 0, 0), (255, 255, 255)))
    labels = np.random.default_rng(0).integers(0, 2, (3, 4, 5)).astype(np.uint8)
    write_slices(tmp_path, painted(labels, table)[..., :3])
    volume = read_png_stack(tmp_path, table, (1, 1, 1))
    assert (volume.labels == labels).all()
    assert volume.names == {"outside": 0, "bone": 1}


def test_unknown_colours_are_listed_with_their_counts(tmp_path):
    rgba = painted(np.ones((3, 3, 3), np.uint8))
    rgba[0, 0, :2] = (1, 2, 3, 255)
    rgba[1, 1, 1] = (255, 249, 219, 128)
    write_slices(tmp_path, rgba)
    for choice in ({}, {"overlaps": "decode", "priority": PRIORITY}):
        with pytest.raises(FileFormatError) as caught:
            read_png_stack(tmp_path, TABLE, (1, 1, 1), **choice)
        assert "(1, 2, 3, 255): 2; (255, 249, 219, 128): 1" in str(caught.value)
        assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("count", [2, 3])
def test_sums_of_labels_are_decoded(tmp_path, count):
    table = real_table()
    groups = list(combinations(range(16), count))
    rgba = np.zeros((len(groups), 1, 1, 4), np.uint8)
    colours = np.array([(*colour, 255) for colour in table.colours])
    for row, group in enumerate(groups):
        rgba[row, 0, 0] = colours[list(group)].sum(axis=0) % 256
    write_slices(tmp_path, rgba)
    with pytest.raises(FileFormatError, match='overlaps="decode"'):
        read_png_stack(tmp_path, table, (1, 1, 1))
    volume = read_png_stack(tmp_path, table, (1, 1, 1), overlaps="decode", priority=REAL_PRIORITY)
    expected = [
        table.labels[table.names.index(next(n for n in REAL_PRIORITY if table.names.index(n) in group))]
        for group in groups
    ]
    assert volume.labels.ravel().tolist() == expected


def test_sums_of_colours_that_were_fractions():
    # 0.9 + 0.9 cut to a whole number is one more than 0 + 0.
    assert TABLE.sums((243, 208, 13, 254)) == [("bone", "nerve")]
    assert TABLE.sums((255 + 244 - 256, 249 + 214 - 256, 219 + 49 - 256, 254)) == [("bone", "nerve")]
    assert TABLE.sums((243, 209, 13, 254)) == []  # two more: not of two labels
    assert TABLE.winner((243, 208, 13, 254), PRIORITY) == "nerve"
    assert TABLE.winner((243, 208, 13, 254), PRIORITY[::-1]) == "bone"


def test_a_sum_that_two_pairs_make_is_unknown_unless_they_agree():
    table = ColourTable(("a", "b", "c", "d"), (1, 2, 3, 4), ((10, 0, 0), (20, 0, 0), (12, 0, 0), (18, 0, 0)))
    assert len(table.sums((30, 0, 0, 254))) == 2
    assert table.winner((30, 0, 0, 254), "abcd") is None
    same = ColourTable(("a", "b", "c"), (1, 2, 3), ((10, 0, 0), (20, 7, 7), (20, 7, 8)))
    assert len(same.sums((30, 8, 9, 254))) == 1
    assert same.winner((30, 8, 8, 254), "abc") == "a"


def test_decoding_needs_a_priority_of_all_names(tmp_path):
    write_slices(tmp_path, painted(np.ones((2, 2, 2), np.uint8)))
    for priority in (None, ("nerve", "bone"), (*PRIORITY, "skin"), ("nerve", "nerve", "bone")):
        with pytest.raises(LabelError, match="priority: expected"):
            read_png_stack(tmp_path, TABLE, (1, 1, 1), overlaps="decode", priority=priority)
    with pytest.raises(InputError, match="overlaps: expected"):
        read_png_stack(tmp_path, TABLE, (1, 1, 1), overlaps="guess")


@pytest.mark.parametrize(
    "change",
    [
        {"spacing": (1, 1)},
        {"spacing": (1, 0, 1)},
        {"spacing": (1, np.nan, 1)},
        {"origin": (0, 0)},
        {"origin": (0, np.nan, 0)},
        {"directions": np.eye(3) * 2},
        {"directions": np.ones((3, 3)) / np.sqrt(3)},
    ],
)
def test_geometry_is_checked(tmp_path, change):
    write_slices(tmp_path, painted(np.ones((2, 2, 2), np.uint8)))
    with pytest.raises(GeometryError):
        read_png_stack(tmp_path, TABLE, **{"spacing": (1, 1, 1), **change})


def test_bad_folders(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_png_stack(tmp_path / "nowhere", TABLE, (1, 1, 1))
    write_slices(tmp_path, painted(np.ones((2, 2, 3), np.uint8)))
    good = (tmp_path / "plane001.png").read_bytes()
    for bad in (b"text", b"", good[: len(good) // 2]):
        (tmp_path / "plane001.png").write_bytes(bad)
        with pytest.raises(FileFormatError, match=r"plane001\.png"):
            read_png_stack(tmp_path, TABLE, (1, 1, 1))
    Image.fromarray(np.zeros((3, 2, 4), np.uint8)).save(tmp_path / "plane001.png")
    with pytest.raises(FileFormatError, match=r"one size.*2 x 3"):
        read_png_stack(tmp_path, TABLE, (1, 1, 1))
    Image.fromarray(np.zeros((2, 2), np.uint8)).save(tmp_path / "plane001.png")
    with pytest.raises(FileFormatError, match="mode L"):
        read_png_stack(tmp_path, TABLE, (1, 1, 1))


def test_writing_replaces_only_what_it_wrote(tmp_path):
    names = {"air": 0, "bone": 1}
    long = LabelVolume(np.ones((2, 2, 9), np.uint8), np.eye(4), names)
    write_png_stack(long, tmp_path / "s", TABLE)
    write_png_stack(long.with_labels(long.labels * 0), tmp_path / "s", TABLE)
    assert not read_png_stack(tmp_path / "s", TABLE, (1, 1, 1)).labels.any()
    write_png_stack(LabelVolume(long.labels[..., :2], np.eye(4), names), tmp_path / "s", TABLE)
    assert len(list((tmp_path / "s").iterdir())) == 2
    (tmp_path / "s" / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="other files"):
        write_png_stack(long, tmp_path / "s", TABLE)
    assert len(list((tmp_path / "s").iterdir())) == 3
    assert [path.name for path in tmp_path.iterdir()] == ["s"]


def test_writing_needs_a_colour_of_the_same_name(tmp_path):
    labels = np.full((2, 2, 2), 10, np.uint8)
    for names in ({"facial": 10}, {"bone": 10}):
        with pytest.raises(LabelError, match="colours: expected"):
            write_png_stack(LabelVolume(labels, np.eye(4), names), tmp_path / "s", TABLE)
    with pytest.raises(LabelError, match="label 11"):
        write_png_stack(LabelVolume(labels + 1, np.eye(4)), tmp_path / "s", TABLE)
    assert not any(tmp_path.iterdir())


def test_colour_table_file(tmp_path):
    path = tmp_path / "colours.csv"
    path.write_text(
        "name, label, r, g, b, source\nbone,1,255,249,219,x\nnerve,10,244,214,49,\ndura,3,110,184,209,y\n"
    )
    assert read_colour_table(path) == TABLE


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "columns"),
        ("name,label,r,g\nbone,1,2,3\n", "got no b"),
        ("name,label,r,g,b\n", "as many"),
        ("name,label,r,g,b\nbone,1,2,3,x\n", "line 2"),
        ("name,label,r,g,b\nbone,1,2,3\n", "line 2"),
        ("name,label,r,g,b\nbone,1,2,3,256\n", "0..255"),
        ("name,label,r,g,b\nbone,300,2,3,4\n", "0..255"),
        ("name,label,r,g,b\nbone,1,2,3,4\nbone,2,3,3,4\n", "every name once"),
        ("name,label,r,g,b\nbone,1,2,3,4\nskin,1,3,3,4\n", "every label once"),
        ("name,label,r,g,b\nbone,1,2,3,4\nskin,2,2,3,4\n", "every colour once"),
        ("\x00\xff", "columns"),
    ],
)
def test_bad_colour_tables(tmp_path, text, says):
    path = tmp_path / "colours.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError) as caught:
        read_colour_table(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    with pytest.raises(FileNotFoundError):
        read_colour_table(tmp_path / "none.csv")


def test_real_stack_agrees_with_the_cleaned_volume(record_property):
    folder, cleaned = real("raw/RT143_256"), read_volume(real("temporal_bone/RT143/labels_native.nrrd"))
    plain = real_table()
    with pytest.raises(FileFormatError, match="got 11 others"):
        read_png_stack(folder, plain, cleaned.spacing)
    volume = read_png_stack(folder, plain, cleaned.spacing, overlaps="decode", priority=REAL_PRIORITY)
    assert volume.affine == pytest.approx(cleaned.affine)
    agree = volume.labels == cleaned.labels
    record_property("share_of_agreeing_voxels", float(agree.mean()))
    # 3352 of 16.6 million voxels differ, all by the second cleaning step of the other side: components of
    # fewer than 20 voxels (bone and TMJ: 200) and unlabelled voxels inside went to their neighbours.
    assert agree.mean() > 0.9995
    for label in np.unique(volume.labels[~agree & (volume.labels > 0)]):
        parts, _ = ndimage.label(volume.labels == label, np.ones((3, 3, 3)))
        sizes = np.bincount(parts.ravel())[parts[~agree & (volume.labels == label)]]
        assert sizes.max() < (200 if volume.names["Bone"] == label else 20)
    codes = np.stack([np.asarray(Image.open(path).convert("RGBA")) for path in sorted_slices(folder)], axis=2)
    summed = (codes[..., 3] != 0) & (codes[..., 3] != 255)
    assert (summed.sum(), agree[summed].sum()) == (508, 506)  # two are an islet of the internal canal
