"""Volumes through files: labels, names and millimetres survive."""

import tempfile
from pathlib import Path

import nibabel as nib
import nrrd
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real
from volume_cases import random_affine, random_volume

from study.errors import InputError
from study.volumes import LabelVolume, read_volume, write_volume

SUFFIXES = (".seg.nrrd", ".nrrd", ".nii", ".nii.gz")
RAS = np.diag([-1, -1, 1, 1])
LABELS = np.random.default_rng(5).integers(0, 3, (3, 4, 5)).astype(np.uint8)


def write_plain_nrrd(path, header, data=LABELS):
    nrrd.write(str(path), data, header)
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32))
def test_round_trip(suffix, seed):
    volume = random_volume(np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"a case.v2{suffix}"
        write_volume(volume, path)
        back = read_volume(path)
        assert [file.name for file in Path(folder).iterdir()] == [path.name]
        assert (read_volume(path, names={"x": 7}).names) == {"x": 7}
    assert (back.labels == volume.labels).all()
    assert back.names == volume.names
    assert back.affine == pytest.approx(volume.affine, abs=1e-6)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "names",
    [
        {"Background or air": 0, "bone": 1, "target": 2},
        {"bone": 1, "protected": 1, "target": 2, "air": 0},  # two names for one label
        {"target": 2},  # labels without a name
        {"air": 3, "outside": 0, "bone": 1, "target": 2},
    ],
)
def test_round_trip_of_unusual_names(tmp_path, suffix, names):
    path = tmp_path / f"v{suffix}"
    write_volume(LabelVolume(LABELS, np.eye(4), names), path)
    assert read_volume(path).names == names


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_sheared_volume_round_trip(tmp_path, suffix):
    affine = random_affine(np.random.default_rng(3))
    affine[:3, 0] += 0.4 * affine[:3, 1]
    write_volume(LabelVolume(LABELS, affine), tmp_path / f"v{suffix}")
    assert read_volume(tmp_path / f"v{suffix}").affine == pytest.approx(affine, abs=1e-6)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_same_volume_same_bytes(tmp_path, suffix):
    volume = random_volume(np.random.default_rng(4))
    for folder in ("a", "b"):
        write_volume(volume, tmp_path / folder / f"v{suffix}")
    assert (tmp_path / "a" / f"v{suffix}").read_bytes() == (tmp_path / "b" / f"v{suffix}").read_bytes()


def test_upper_case_suffix(tmp_path):
    write_volume(LabelVolume(LABELS, np.eye(4)), tmp_path / "V.NRRD")
    assert (read_volume(str(tmp_path / "V.NRRD")).labels == LABELS).all()


@pytest.mark.parametrize(
    ("space", "flip"),
    [
        ("left-posterior-superior", (1, 1, 1)),
        ("LPS", (1, 1, 1)),
        ("right-anterior-superior", (-1, -1, 1)),
        ("RAS", (-1, -1, 1)),
        ("left-anterior-superior", (1, -1, 1)),
        ("LAS", (1, -1, 1)),
    ],
)
def test_nrrd_space_becomes_lps(tmp_path, space, flip):
    affine = random_affine(np.random.default_rng(6))
    path = write_plain_nrrd(
        tmp_path / "v.nrrd",
        {"space": space, "space directions": affine[:3, :3].T, "space origin": affine[:3, 3]},
    )
    volume = read_volume(path)
    index = np.array([[2, 1, 3]])
    expected = (affine @ [2, 1, 3, 1])[:3] * flip
    assert volume.points(index)[0] == pytest.approx(expected, abs=1e-9)
    assert volume.names == {"air": 0, "protected": 1, "target": 2}


def test_nrrd_with_spacings_only(tmp_path):
    volume = read_volume(write_plain_nrrd(tmp_path / "v.nrrd", {"spacings": [0.5, 0.6, 0.7]}))
    assert volume.affine == pytest.approx(np.diag([0.5, 0.6, 0.7, 1]))
    assert (volume.labels == LABELS).all()


def test_nrrd_in_other_units(tmp_path):
    header = {
        "space": "LPS",
        "space directions": np.eye(3) * 0.05,
        "space origin": [1, 2, 3],
        "space units": ["cm"] * 3,
    }
    volume = read_volume(write_plain_nrrd(tmp_path / "v.nrrd", header))
    assert volume.spacing == pytest.approx([0.5] * 3)
    assert volume.affine[:3, 3] == pytest.approx([10, 20, 30])


@pytest.mark.parametrize("dtype", [np.int16, np.uint32, np.int64, np.float32, np.float64])
@pytest.mark.parametrize("encoding", ["gzip", "raw", "ascii", "bzip2"])
def test_nrrd_types_and_encodings(tmp_path, dtype, encoding):
    header = {"space": "LPS", "space directions": np.eye(3), "encoding": encoding}
    path = write_plain_nrrd(tmp_path / "v.nrrd", header, LABELS.astype(dtype))
    assert (read_volume(path).labels == LABELS).all()


@pytest.mark.parametrize("where", ["front", "back"])
def test_nrrd_with_a_fourth_axis_of_one(tmp_path, where):
    none, eye = [[np.nan] * 3], np.eye(3).tolist()
    rows, data = (none + eye, LABELS[None]) if where == "front" else (eye + none, LABELS[..., None])
    path = write_plain_nrrd(tmp_path / "v.nrrd", {"space": "LPS", "space directions": np.array(rows)}, data)
    assert (read_volume(path).labels == LABELS).all()
    spaced = write_plain_nrrd(tmp_path / "s.nrrd", {"spacings": [1, 2, 3, 1]}, LABELS[..., None])
    assert read_volume(spaced).spacing == pytest.approx([1, 2, 3])


def test_nrrd_crlf_header_with_foreign_keys(tmp_path):
    head = (
        "NRRD0004\n# comment\ntype: uchar\ndimension: 3\nspace: left-posterior-superior\nsizes: 3 4 5\n"
        "space directions: (1,0,0) (0,1,0) (0,0,1)\nkinds: domain domain domain\nencoding: raw\n"
        "space origin: (0,0,0)\nmeasurement frame: (1,0,0) (0,1,0) (0,0,1)\nDICOM_0010:=x: y := z\n\n"
    )
    (tmp_path / "v.nrrd").write_bytes(head.replace("\n", "\r\n").encode() + LABELS.tobytes(order="F"))
    assert (read_volume(tmp_path / "v.nrrd").labels == LABELS).all()


@pytest.mark.parametrize("form", ["sform", "qform", "nifti2"])
@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32, np.float64])
def test_nifti_ras_becomes_lps(tmp_path, form, dtype):
    affine = random_affine(np.random.default_rng(8))
    kind = nib.Nifti2Image if form == "nifti2" else nib.Nifti1Image
    image = kind(LABELS.astype(dtype), affine)
    if form == "qform":
        image.set_qform(affine, code=1)
        image.set_sform(None, code=0)
    nib.save(image, tmp_path / "v.nii.gz")
    volume = read_volume(tmp_path / "v.nii.gz")
    # A header of NIfTI-1 is single precision.
    assert volume.affine == pytest.approx(RAS @ affine, abs=2e-4)
    assert (volume.labels == LABELS).all()


def test_nifti_written_is_what_others_read(tmp_path):
    volume = random_volume(np.random.default_rng(9))
    write_volume(volume, tmp_path / "v.nii.gz")
    image = nib.load(tmp_path / "v.nii.gz")
    assert image.get_data_dtype() == np.uint8
    assert (np.asarray(image.dataobj) == volume.labels).all()
    for affine in (image.get_sform(), image.get_qform()):
        assert affine == pytest.approx(RAS @ volume.affine, abs=2e-4)
    assert image.header.get_xyzt_units()[0] == "mm"


def test_nifti_moved_by_another_tool_is_where_its_header_says(tmp_path):
    write_volume(random_volume(np.random.default_rng(10)), tmp_path / "v.nii")
    image = nib.load(tmp_path / "v.nii")
    moved = image.affine.copy()
    moved[:3, 3] += 5
    other = nib.Nifti1Image(np.asarray(image.dataobj), moved, image.header)
    nib.save(other, tmp_path / "w.nii")
    assert read_volume(tmp_path / "w.nii").affine == pytest.approx(RAS @ moved, abs=2e-4)


def test_nifti_in_metres_and_with_a_fourth_axis_of_one(tmp_path):
    image = nib.Nifti1Image(LABELS[..., None], np.diag([0.001, 0.001, 0.002, 1]))
    image.header.set_xyzt_units("meter")
    nib.save(image, tmp_path / "v.nii")
    assert read_volume(tmp_path / "v.nii").spacing == pytest.approx([1, 1, 2], rel=1e-6)


def test_nifti_with_somebody_elses_comment(tmp_path):
    image = nib.Nifti1Image(LABELS, np.eye(4))
    for content in (b"not json", b"[1, 2]", b'{"study": 3}'):
        image.header.extensions.append(nib.nifti1.Nifti1Extension(6, content))
    nib.save(image, tmp_path / "v.nii")
    assert read_volume(tmp_path / "v.nii").names == {"air": 0, "protected": 1, "target": 2}


def test_files_without_names(tmp_path):
    path = write_plain_nrrd(tmp_path / "v.nrrd", {"spacings": [1, 1, 1]}, LABELS + np.uint8(1))
    assert read_volume(path).names == {"label_1": 1, "label_2": 2, "label_3": 3}
    assert read_volume(path, names={"bone": 1}).names == {"bone": 1}
    with pytest.raises(InputError, match="names: expected"):
        read_volume(path, names={"bone": 300})


def test_colours_are_checked(tmp_path):
    volume = LabelVolume(LABELS, np.eye(4))
    write_volume(volume, tmp_path / "v.seg.nrrd", colours={"target": (0.5, 0, 1)})
    header = nrrd.read_header(str(tmp_path / "v.seg.nrrd"))
    assert [float(part) for part in header["Segment1_Color"].split()] == [0.5, 0, 1]
    for suffix, colours in ((".nrrd", {"target": (1, 1, 1)}), (".seg.nrrd", {"nerve": (1, 1, 1)})):
        with pytest.raises(InputError, match="colours: expected"):
            write_volume(volume, tmp_path / f"w{suffix}", colours=colours)
    for colour in ((1, 1), (1, 2, 0)):
        with pytest.raises(InputError, match="three numbers"):
            write_volume(volume, tmp_path / "w.seg.nrrd", colours={"target": colour})
    assert [path.name for path in tmp_path.iterdir()] == ["v.seg.nrrd"]


def test_real_temporal_bone():
    volume = read_volume(real("temporal_bone/RT143/planning_0p38.nrrd"))
    assert volume.shape == (160, 128, 127)
    assert volume.names == {"air": 0, "protected": 1, "target": 2}
    assert volume.affine[:3, 3] == pytest.approx([-12.204573, 0.096099, 0.09601])
    # The README of the data states 4.567 cm^3.
    assert volume.volume_mm3("target") / 1000 == pytest.approx(4.567, abs=5e-4)


def test_real_kidney():
    volume = read_volume(real("kidney/case_00101/labels_1mm.nrrd"), names={"kidney": 1, "tumour": 2})
    assert volume.volume_mm3("tumour") / 1000 == pytest.approx(4.99, abs=5e-3)
    assert volume.volume_mm3("kidney") / 1000 == pytest.approx(183.68, abs=5e-3)


def test_real_kidney_as_published():
    cleaned = read_volume(real("kidney/case_00101/labels_1mm.nrrd"))
    raw = read_volume(real("raw/case_00101/segmentation.nii.gz"))
    # Both say where the tumour is; the frames (RAS there, LPS here) must agree.
    centres = [volume.points(np.argwhere(volume.mask("target"))).mean(axis=0) for volume in (cleaned, raw)]
    assert centres[0] == pytest.approx(centres[1], abs=0.3)
