"""Readers of public cases: whole folders, bare label files, broken ones."""

import json

import numpy as np
import pytest
from real_data import real

from study.errors import FileFormatError, InputError, LabelError
from study.specimens import (
    Specimen,
    TargetRule,
    TemporalBoneParameters,
    mastoidectomy_target,
    read_temporal_bone_case,
    structure_mask,
    temporal_bone,
)
from study.specimens.structures import PUBLIC_LABELS
from study.volumes import LabelVolume, write_volume

FIVE = (
    "facial_nerve",
    "chorda_tympani",
    "external_auditory_canal",
    "internal_auditory_canal",
    "sigmoid_sinus",
)
#: Our structures as the public set numbers them; what it has no label for is background there.
TO_PUBLIC = {
    "bone": "Bone",
    "facial_nerve": "Facial_Nerve",
    "chorda_tympani": "Chorda_Tympani",
    "external_auditory_canal": "EAC",
    "internal_auditory_canal": "IAC",
    "labyrinth": "Bony_Labyrinth",
    "sigmoid_sinus": "Sinus_Dura",
    "dura": "Sinus_Dura",
    "malleus": "Malleus",
    "incus": "Incus",
    "stapes": "Stapes",
    "carotid_artery": "ICA",
    "temporomandibular_joint": "TMJ",
}


@pytest.fixture(scope="module")
def public_like():
    """A procedural bone under the public set's labels, cut off before the lateral air."""
    bone = temporal_bone(TemporalBoneParameters.drawn(21, "left"), 21, spacing=0.6)
    table = np.zeros(256, np.uint8)
    for ours, theirs in TO_PUBLIC.items():
        table[bone.names[ours]] = PUBLIC_LABELS[theirs]
    labels = table[bone.labels]
    last = np.flatnonzero(labels.any(axis=(1, 2)))[-1]
    return LabelVolume(labels[: last + 2], bone.affine, PUBLIC_LABELS)


def write_case(folder, volume, names=True):
    plain = LabelVolume(volume.labels, volume.affine, {f"label_{n}": n for n in range(17)})
    write_volume(plain, folder / "labels_0p38.nrrd")
    if names:
        case = {
            "case": "Z1",
            "side": "left",
            "labels": {str(value): name for name, value in PUBLIC_LABELS.items()},
        }
        (folder / "case.json").write_text(json.dumps(case))


def test_label_file_alone_is_enough(public_like, tmp_path):
    write_case(tmp_path, public_like, names=False)
    found = read_temporal_bone_case(tmp_path)
    assert (found.side, found.name) == ("left", tmp_path.name)
    for name in FIVE:
        assert structure_mask(found.anatomy, name).any()
    assert found.anatomy.mask("facial_nerve").any()
    assert found.fiducials.shape == (6, 3)
    assert found.rule == TargetRule()
    # The image ended at the bone: 12 mm of air are added on the lateral side alone.
    solid = np.flatnonzero((found.anatomy.labels > 0).any(axis=(1, 2)))
    assert (found.anatomy.shape[0] - 1 - solid[-1]) * 0.6 >= 12
    assert np.array_equal(found.anatomy.labels[: public_like.shape[0]], public_like.labels)
    assert np.allclose(found.anatomy.affine, public_like.affine)


def test_whole_case_is_read(public_like, tmp_path):
    write_case(tmp_path, public_like)
    bare = read_temporal_bone_case(tmp_path)
    assert bare.name == "Z1"
    write_volume(mastoidectomy_target(bare.anatomy, TargetRule(max_radius=12.0)), tmp_path / "planning.nrrd")
    (tmp_path / "fiducials.json").write_text(json.dumps({"positions": [[0, 0, 0], [10, 0, 0], [0, 9, 1]]}))
    whole = read_temporal_bone_case(tmp_path)
    assert whole.rule is None
    assert whole.planning.volume_mm3("target") < bare.planning.volume_mm3("target")
    assert whole.fiducials.tolist() == [[0, 0, 0], [10, 0, 0], [0, 9, 1]]
    assert read_temporal_bone_case(tmp_path, rule=TargetRule()).planning.labels.tobytes() == (
        bare.planning.labels.tobytes()
    )


def test_unlabelled_brain_is_not_target(public_like, tmp_path):
    write_case(tmp_path, public_like)
    found = read_temporal_bone_case(tmp_path)
    bone = temporal_bone(TemporalBoneParameters.drawn(21, "left"), 21, spacing=0.6)
    n = min(bone.shape[0], found.planning.shape[0])
    target = found.planning.mask("target")[:n]
    assert not (target & bone.mask("intracranial")[:n]).any()


@pytest.mark.parametrize(
    ("name", "content", "matched"),
    [
        ("case.json", "{", "case.json"),
        ("case.json", "[1]", "case.json.*object"),
        ("case.json", '{"side": "up"}', "case.json.*side"),
        ("case.json", '{"labels": ["a"]}', "case.json.*labels"),
        ("fiducials.json", "{}", "fiducials.json.*positions"),
        ("fiducials.json", '{"positions": [[1, 2]]}', "fiducials.json"),
        ("fiducials.json", '{"positions": [[1, 2, 3]]}', "fiducials.json.*three"),
    ],
)
def test_broken_side_files_are_named(public_like, tmp_path, name, content, matched):
    write_case(tmp_path, public_like)
    (tmp_path / name).write_text(content)
    with pytest.raises(FileFormatError, match=matched):
        read_temporal_bone_case(tmp_path)


def test_missing_folders_and_files(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        read_temporal_bone_case(tmp_path / "nowhere")
    with pytest.raises(FileFormatError, match="none"):
        read_temporal_bone_case(tmp_path)
    with pytest.raises(FileNotFoundError, match=r"x\.nrrd"):
        read_temporal_bone_case(tmp_path, labels="x.nrrd")


def test_labels_without_meaning_are_refused(tmp_path):
    labels = np.full((4, 4, 4), 60, np.uint8)
    write_volume(LabelVolume(labels, np.eye(4), {"label_60": 60}), tmp_path / "a.nrrd")
    with pytest.raises(LabelError, match=r"a\.nrrd.*60"):
        read_temporal_bone_case(tmp_path)


def test_specimen_wants_one_grid(public_like):
    other = LabelVolume(np.zeros((3, 3, 3), np.uint8), np.eye(4))
    with pytest.raises(InputError, match="one grid"):
        Specimen("a", "left", public_like, other, np.zeros((6, 3)))
    with pytest.raises(InputError, match="fiducials"):
        Specimen("a", "left", public_like, public_like, np.zeros((6, 2)))


@pytest.mark.parametrize(("case", "side"), [("RT143", "right"), ("LT143", "left"), ("LT151", "left")])
def test_real_bones(case, side):
    found = read_temporal_bone_case(real(f"temporal_bone/{case}"))
    assert (found.name, found.side, found.fiducials.shape) == (case, side, (6, 3))
    assert found.rule is None
    assert found.planning.mask("target").any()
    for name in FIVE:
        assert structure_mask(found.anatomy, name).any()
