"""What a case knows beyond its planning volume: fiducials, side, and a target drawn nearer."""

from dataclasses import replace

import numpy as np
import pytest
from planning_cases import small_cone
from real_data import real

from study.cases import Case, load_case
from study.errors import InputError
from study.specimens import fiducial_ring, read_temporal_bone_case, specimen
from study.volumes import write_volume


@pytest.fixture(scope="module")
def case():
    return load_case("TB14")


def test_catalogue_specimen_brings_its_own_fiducials(case):
    np.testing.assert_array_equal(case.fiducials, specimen("TB14").fiducials)
    assert case.side == specimen("TB14").side and case.rule == specimen("TB14").rule


def test_planning_volume_alone_has_no_fiducials(tmp_path):
    write_volume(small_cone(), tmp_path / "mine.seg.nrrd")
    case = load_case(tmp_path / "mine.seg.nrrd")
    assert case.fiducials is None and case.side is None
    with pytest.raises(InputError, match="anatomy"):
        case.with_clearance(0.0, ["facial_nerve"])


def test_file_with_structures_gets_the_ring(case, tmp_path):
    write_volume(case.anatomy, tmp_path / "bone.seg.nrrd")
    mine = load_case(tmp_path / "bone.seg.nrrd")
    assert mine.side == case.side
    np.testing.assert_allclose(mine.fiducials, fiducial_ring(mine.planning, case.side), atol=1e-3)


def test_file_with_target_and_structures_gets_the_ring(case, tmp_path):
    labels = case.anatomy.labels.copy()
    names = {**case.anatomy.names, "target": max(case.anatomy.names.values()) + 1}
    labels[case.planning.mask("target")] = names["target"]
    write_volume(case.anatomy.with_labels(labels, names), tmp_path / "both.seg.nrrd")
    mine = load_case(tmp_path / "both.seg.nrrd")
    assert mine.side == case.side
    np.testing.assert_allclose(mine.fiducials, fiducial_ring(case.planning, case.side), atol=1e-3)


def test_clearance_moves_the_target_to_the_structures_and_nowhere_else(case):
    names = ("facial_nerve", "external_auditory_canal")
    near = case.with_clearance(0.0, names)
    before, after = case.planning.mask("target"), near.planning.mask("target")
    assert (before & ~after).sum() == 0 and after.sum() > before.sum()
    for name in names:
        assert not (after & case.structure(name)).any()
    assert near.rule == replace(case.rule, clearances={**case.rule.clearances, **dict.fromkeys(names, 0.0)})
    same = case.with_clearance(case.rule.clearances["facial_nerve"], ["facial_nerve"])
    np.testing.assert_array_equal(same.planning.labels, case.planning.labels)


def test_folder_keeps_the_fiducials_of_its_file():
    folder = real("temporal_bone/RT143")
    case = load_case(folder)
    assert isinstance(case, Case) and case.side == "right"
    np.testing.assert_array_equal(case.fiducials, read_temporal_bone_case(folder).fiducials)
