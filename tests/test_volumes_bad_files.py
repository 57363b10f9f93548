"""Files that are not label maps: the right error, and the file's name in it."""

import gzip

import nibabel as nib
import nrrd
import numpy as np
import pytest

from study.errors import FileFormatError, GeometryError, StudyError
from study.volumes import LabelVolume, read_volume, write_volume

SUFFIXES = (".seg.nrrd", ".nrrd", ".nii", ".nii.gz")
LABELS = np.random.default_rng(5).integers(0, 3, (6, 7, 8)).astype(np.uint8)
VOLUME = LabelVolume(LABELS, np.eye(4))
EYE = {"space": "left-posterior-superior", "space directions": np.eye(3), "space origin": [0, 0, 0]}


def refused(path, kind=FileFormatError, says=""):
    with pytest.raises(kind) as caught:
        read_volume(path)
    assert str(path) in str(caught.value)
    assert says in str(caught.value)
    assert isinstance(caught.value, StudyError) or kind is FileNotFoundError


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_missing_file(tmp_path, suffix):
    refused(tmp_path / f"v{suffix}", FileNotFoundError)


@pytest.mark.parametrize("name", ["v.png", "v.stl", "v", "nrrd", "v.nii.bz2"])
def test_unknown_suffix(tmp_path, name):
    (tmp_path / name).write_bytes(b"x")
    refused(tmp_path / name, says=".seg.nrrd")
    with pytest.raises(FileFormatError, match=r"\.seg\.nrrd"):
        write_volume(VOLUME, tmp_path / "new" / name)
    assert not (tmp_path / "new").exists()


def test_folder(tmp_path):
    (tmp_path / "v.nrrd").mkdir()
    refused(tmp_path / "v.nrrd", says="folder")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\n",
        b"this is text\nand more of it\n",
        bytes(range(256)) * 40,
        b"NRRD0005\n",
        b"NRRD0005\ntype\n",
    ],
    ids=["empty", "newline", "text", "bytes", "magic", "half a header"],
)
def test_something_else(tmp_path, suffix, content):
    path = tmp_path / f"v{suffix}"
    path.write_bytes(content)
    refused(path)


@pytest.mark.parametrize(
    "content",
    [b"no gzip at all", gzip.compress(b"gzip of no NIfTI" * 99)],
    ids=["no gzip", "gzip of no NIfTI"],  # gzip stamps the time: workers would name the test apart
)
def test_gz_of_something_else(tmp_path, content):
    (tmp_path / "v.nii.gz").write_bytes(content)
    refused(tmp_path / "v.nii.gz", says="NIfTI")


def test_nifti_under_the_other_suffix(tmp_path):
    write_volume(VOLUME, tmp_path / "a.nii")
    (tmp_path / "a.nii").rename(tmp_path / "b.nii.gz")
    refused(tmp_path / "b.nii.gz")
    write_volume(VOLUME, tmp_path / "a.nii.gz")
    (tmp_path / "a.nii.gz").rename(tmp_path / "b.nrrd")
    refused(tmp_path / "b.nrrd")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kept", [0.1, 0.5, 0.9, -1, -9])
def test_truncated(tmp_path, suffix, kept):
    path = tmp_path / f"v{suffix}"
    write_volume(VOLUME, path)
    content = path.read_bytes()
    path.write_bytes(content[: int(kept * len(content)) if kept > 0 else int(kept)])
    refused(path)


@pytest.mark.parametrize("suffix", [".nrrd", ".nii.gz"])
def test_damaged(tmp_path, suffix):
    path = tmp_path / f"v{suffix}"
    write_volume(VOLUME, path)
    content = bytearray(path.read_bytes())
    content[-40] ^= 0xFF
    path.write_bytes(content)
    refused(path)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (LABELS * 0.5, "0.5"),
        (np.where(LABELS == 1, np.nan, LABELS), "nan"),
        (np.where(LABELS == 1, np.inf, LABELS), "inf"),
        (LABELS.astype(np.int16) - 1, "-1"),
        (LABELS.astype(np.int32) + 254, "256"),
        (LABELS.astype(float) - 1, "-1"),
        (LABELS.astype(np.float32) * 1000, "2000"),
    ],
)
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_voxels_that_are_no_labels(tmp_path, suffix, data, says):
    path = tmp_path / f"v{suffix}"
    if suffix.endswith("nrrd"):
        nrrd.write(str(path), data, dict(EYE))
    else:
        nib.save(nib.Nifti1Image(data, np.eye(4), dtype=data.dtype), path)
    refused(path, says=says)


def test_nifti_scaled_to_fractions(tmp_path):
    image = nib.Nifti1Image(LABELS, np.eye(4))
    image.header.set_slope_inter(0.5, 0)
    nib.save(image, tmp_path / "v.nii")
    refused(tmp_path / "v.nii", says="0.5")


def test_nifti_of_colours(tmp_path):
    rgb = np.zeros((3, 4, 5), [("R", "u1"), ("G", "u1"), ("B", "u1")])
    nib.save(nib.Nifti1Image(rgb, np.eye(4)), tmp_path / "v.nii")
    refused(tmp_path / "v.nii", says="one number a voxel")


@pytest.mark.parametrize("shape", [(6, 7), (6, 7, 8, 2), (6, 7, 8, 1, 2)])
def test_not_three_dimensions(tmp_path, shape):
    data = np.ones(shape, np.uint8)
    nib.save(nib.Nifti1Image(data, np.eye(4)), tmp_path / "v.nii")
    refused(tmp_path / "v.nii", says=str(shape))
    nrrd.write(str(tmp_path / "v.nrrd"), data, {"spacings": [1] * len(shape)})
    refused(tmp_path / "v.nrrd", GeometryError, says="three axes")


def test_nrrd_list_of_volumes_without_segments(tmp_path):
    rows = np.array([[np.nan] * 3, *np.eye(3).tolist()])
    nrrd.write(str(tmp_path / "v.nrrd"), np.stack([LABELS] * 2), {**EYE, "space directions": rows})
    refused(tmp_path / "v.nrrd", says="(2, 6, 7, 8)")


NAN_PART = np.diag([1, np.nan, 1])
NO_ROW = np.array([[1, 0, 0], [np.nan] * 3, [0, 0, 1]])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"space directions": None}, "neither"),
        ({"space directions": NAN_PART}, "nan"),
        ({"space directions": NO_ROW}, "three axes"),
        ({"space directions": np.diag([1, 0, 1])}, "invertible"),
        ({"space directions": np.ones((3, 3))}, "invertible"),
        ({"space directions": np.eye(3)[:, :2]}, "3-D"),
        ({"space directions": np.eye(3)[:2]}, "3-D"),
        ({"space directions": None, "spacings": [1, np.nan, 1]}, "nan"),
        ({"space directions": None, "spacings": [1, 0, 1]}, "positive"),
        ({"space directions": None, "spacings": [1, -1, 1]}, "positive"),
        ({"space directions": None, "spacings": [1, np.inf, 1]}, "inf"),
        ({"space directions": None, "spacings": [1, 1]}, "3 spacings"),
        ({"space origin": [0, np.inf, 0]}, "inf"),
        ({"space origin": [0, 0]}, "origin"),
        ({"space": "scanner-xyz"}, "scanner-xyz"),
        ({"space": "left-left-superior"}, "left-left-superior"),
        ({"space": "3D-right-handed"}, "3D-right-handed"),
        ({"space units": ["inch"] * 3}, "inch"),
    ],
)
def test_nrrd_geometry(tmp_path, change, says):
    header = {key: value for key, value in {**EYE, **change}.items() if value is not None}
    nrrd.write(str(tmp_path / "v.nrrd"), LABELS, header)
    refused(tmp_path / "v.nrrd", GeometryError, says)


def test_nrrd_partly_missing_origin(tmp_path):
    nrrd.write(str(tmp_path / "v.nrrd"), LABELS, dict(EYE))
    raw = (tmp_path / "v.nrrd").read_bytes()
    (tmp_path / "v.nrrd").write_bytes(raw.replace(b"space origin: (0,0,0)", b"space origin: (0,nan,0)"))
    refused(tmp_path / "v.nrrd", GeometryError, "nan")


@pytest.mark.parametrize("where", [(0, 3), (1, 1)])
def test_nifti_geometry(tmp_path, where):
    image = nib.Nifti1Image(LABELS, np.eye(4))
    image.header[f"srow_{'xyz'[where[0]]}"][where[1]] = np.nan
    image.header["sform_code"] = 1
    with (tmp_path / "v.nii").open("wb") as stream:
        stream.write(image.header.binaryblock + bytes(4) + LABELS.tobytes(order="F"))
    raw = bytearray((tmp_path / "v.nii").read_bytes())
    raw[108:112] = np.float32(352).tobytes()  # where the voxels start
    (tmp_path / "v.nii").write_bytes(raw)
    refused(tmp_path / "v.nii", GeometryError, "finite")


def test_nifti_without_orientation(tmp_path):
    nib.save(nib.Nifti1Image(LABELS, None), tmp_path / "v.nii")
    refused(tmp_path / "v.nii", GeometryError, "sform or a qform")


@pytest.mark.parametrize("text", ["[1]", '{"a": 300}', '{"a": "b"}', '{"a": tru', '{"a": true}'])
def test_stored_names_that_are_none(tmp_path, text):
    nrrd.write(str(tmp_path / "v.nrrd"), LABELS, {**EYE, "study_label_names": text})
    refused(tmp_path / "v.nrrd", says="names")


def test_nrrd_with_its_data_elsewhere(tmp_path):
    nrrd.write(str(tmp_path / "v.nhdr"), LABELS, dict(EYE))
    (tmp_path / "v.nhdr").rename(tmp_path / "v.nrrd")
    assert (read_volume(tmp_path / "v.nrrd").labels == LABELS).all()
    (tmp_path / "v.raw.gz").unlink()
    refused(tmp_path / "v.nrrd", says="v.raw.gz")


def test_failed_writing_leaves_the_old_file(tmp_path, monkeypatch):
    for suffix in SUFFIXES:
        path = tmp_path / f"v{suffix}"
        write_volume(VOLUME, path)
        before = path.read_bytes()
        with monkeypatch.context() as patch:
            patch.setattr("nrrd.write", lambda *args, **kwargs: 1 / 0)
            patch.setattr("nibabel.save", lambda *args, **kwargs: 1 / 0)
            with pytest.raises(ZeroDivisionError):
                write_volume(VOLUME.with_labels(LABELS * 0), path)
        assert path.read_bytes() == before
    assert len(list(tmp_path.iterdir())) == len(SUFFIXES)
