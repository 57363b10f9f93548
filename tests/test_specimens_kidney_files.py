"""Kidneys from files: prepared, as the challenge publishes them, and broken ones."""

import json

import nibabel as nib
import numpy as np
import pytest
import trimesh
from real_data import real
from scipy import ndimage
from scipy.spatial import cKDTree

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.specimens import (
    KIDNEY_NAMES,
    KidneyParameters,
    affected_kidney,
    exophytic_share,
    kidney,
    kidney_surface,
    load_kidney,
    read_kidney_case,
    trace_swab,
    tumour_sections,
)
from study.specimens.kidney_room import KIDNEY_ROOM, TUMOUR_ROOM
from study.volumes import LabelVolume, write_surface, write_volume

PARAMETERS = KidneyParameters(side="left", tumour_diameter=30.0, tumour_depth=4.0)
#: Voxel index to mm as the challenge has it (RAS): axes run down, backwards, to the left.
CHALLENGE = np.array([[0, 0, -1.1, 0], [0, -1.1, 0, 0], [-3.0, 0, 0, 0], [0, 0, 0, 1.0]])


@pytest.fixture(scope="module")
def truth():
    return kidney(PARAMETERS, 11, 1.0)


@pytest.fixture(scope="module")
def coarse():
    return kidney(PARAMETERS, 11, 2.5)


@pytest.fixture(scope="module")
def prepared(coarse, tmp_path_factory):
    """A folder with everything a prepared case has; voxels of 2.5 mm, so that it is read quickly."""
    folder = tmp_path_factory.mktemp("prepared")
    write_case(folder, coarse)
    return folder


def write_case(folder, truth):
    write_volume(truth, folder / "labels_1mm.nrrd")
    surface = kidney_surface(truth, pitch_mm=3.0)
    write_surface(surface, folder / "kidney_with_tumour.stl")
    centre = truth.points(np.argwhere(truth.mask("tumour"))).mean(axis=0)
    write_swab(folder, trace_swab(surface, centre))
    (folder / "case.json").write_text(json.dumps({"case": "case_7", "side": "left"}))


def write_swab(folder, points):
    np.savetxt(folder / "swab.csv", points, delimiter=",", header="x,y,z", comments="")


def copied(prepared, tmp_path):
    for path in prepared.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def sampled(volume, affine_ras, corner, shape):
    """What a scanner with these axes would see of a volume: (shape) labels, affine with that corner."""
    affine = affine_ras.copy()
    affine[:3, 3] = corner
    place = np.linalg.inv(volume.affine) @ np.diag([-1.0, -1, 1, 1]) @ affine
    return ndimage.affine_transform(volume.labels, place, output_shape=shape, order=0), affine


def scan_of(truth, affine_ras, with_other=True):
    """A scan with both kidneys, a second small tumour, and a stray voxel, tightly around them."""
    low, high = (
        f(truth.points(np.argwhere(truth.mask("kidney", "tumour"))), axis=0) for f in (np.min, np.max)
    )
    low, high = low - [150.0, 3, 3], high + 3  # to the right, where the other kidney is
    box = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T * [-1, -1, 1]
    inverse = np.linalg.inv(affine_ras[:3, :3])
    reach = box @ inverse.T
    corner = affine_ras[:3, :3] @ reach.min(axis=0)
    shape = tuple(np.ceil(np.ptp(reach, axis=0)).astype(int) + 1)
    labels, affine = sampled(truth, affine_ras, corner, shape)
    if with_other:
        moved = truth.affine.copy()
        mirror = np.diag([-1.0, 1, 1, 1])
        moved = mirror @ moved
        moved[0, 3] -= 110.0
        healthy = np.minimum(truth.labels, 1)
        # A tumour of the other kidney, smaller than the one that counts.
        centre = np.argwhere(truth.mask("kidney")).mean(axis=0)
        ball = np.linalg.norm(np.indices(truth.shape) - centre[:, None, None, None], axis=0) < 6
        other = LabelVolume(np.where(ball, 2, healthy), moved, KIDNEY_NAMES)
        more, _ = sampled(other, affine_ras, corner, shape)
        labels = np.maximum(labels, more)
    return labels, affine


def write_scan(path, labels, affine):
    nib.save(nib.Nifti1Image(labels, affine), path)


def turned(degrees, axis):
    return trimesh.transformations.rotation_matrix(np.deg2rad(degrees), axis)


@pytest.mark.parametrize(
    "affine",
    [
        CHALLENGE,
        np.diag([1.9, -1.3, 1.2, 1.0]),
        turned(12, [1, 2, 3]) @ CHALLENGE,
    ],
    ids=["challenge", "flipped", "oblique"],
)
def test_a_raw_scan_gives_the_kidney_it_was_made_of(truth, tmp_path, affine):
    labels, placed = scan_of(truth, affine)
    write_scan(tmp_path / "segmentation.nii.gz", labels, placed)
    case = read_kidney_case(tmp_path)
    assert (case.name, case.side) == (tmp_path.name, "left")
    assert np.allclose(case.anatomy.spacing, 1.0, atol=0.01)
    for name in ("kidney", "tumour"):
        assert case.anatomy.volume_mm3(name) == pytest.approx(truth.volume_mm3(name), rel=0.03)
        centres = [v.points(np.argwhere(v.mask(name))).mean(axis=0) for v in (case.anatomy, truth)]
        assert np.allclose(*centres, atol=0.5)
    for name, room in (("tumour", TUMOUR_ROOM), ("kidney", KIDNEY_ROOM)):
        indices = np.argwhere(case.anatomy.mask(name))
        ends = indices.min(axis=0), np.array(case.anatomy.shape) - 1 - indices.max(axis=0)
        assert (np.array(ends) * case.anatomy.spacing >= room - 1e-6).all()
    assert case.surface.is_watertight
    distance = cKDTree(kidney_surface(truth, pitch_mm=1.0).vertices).query(case.surface.vertices)[0]
    assert np.quantile(distance, 0.95) < 1.2  # vertices 0.8 mm apart, slices of 3 mm
    assert 600 < len(case.swab) < 800
    distance = trimesh.proximity.closest_point(case.surface, case.swab)[1]
    assert np.sqrt(np.mean(distance**2)) == pytest.approx(0.3, rel=0.1)  # noise along the normal
    assert (
        load_kidney(tmp_path / "segmentation.nii.gz").anatomy.labels.tobytes()
        == case.anatomy.labels.tobytes()
    )


def test_the_kidney_of_the_largest_tumour(truth):
    labels, placed = scan_of(truth, CHALLENGE)
    lps = np.diag([-1.0, -1, 1, 1]) @ placed
    found, side = affected_kidney(LabelVolume(labels, lps, KIDNEY_NAMES))
    assert side == "left"
    alone, nothing = affected_kidney(
        LabelVolume(scan_of(truth, CHALLENGE, with_other=False)[0], lps, KIDNEY_NAMES)
    )
    assert nothing == ""
    assert np.array_equal(alone.labels, found.labels)
    # A second tumour in the same kidney is kidney; so is a cyst, and a cavity; stray voxels go.
    more = labels.copy()
    own = np.argwhere(more == 2)
    own = own[(own @ lps[:3, :3].T + lps[:3, 3])[:, 0] > 0]
    kidney_voxels = np.argwhere(more == 1)
    kidney_voxels = kidney_voxels[(kidney_voxels @ lps[:3, :3].T + lps[:3, 3])[:, 0] > 0]
    far = kidney_voxels[
        np.argsort(-np.abs((kidney_voxels - own.mean(axis=0)) @ np.diag([3, 0.8, 0.8])).sum(1))
    ]
    for value, place in ((2, far[len(far) // 3]), (3, far[len(far) // 4]), (0, _deepest(more, own))):
        more[tuple(place)] = value
    more[0, 0, 0] = 1
    again, _ = affected_kidney(LabelVolume(more, lps, KIDNEY_NAMES))
    assert np.array_equal(again.labels, found.labels)


def _deepest(labels, near):
    """A kidney voxel all around which is kidney, in the half of the tumour's kidney away from it."""
    pieces, _ = ndimage.label(labels > 0, np.ones((3, 3, 3)))
    inside = (pieces == pieces[tuple(near[0])]) & (labels == 1)
    depth = ndimage.distance_transform_edt(inside, sampling=(3.0, 1.1, 1.1))
    return np.unravel_index(np.argmax(depth), labels.shape)


def test_a_tumour_of_no_kidney(coarse, tmp_path):
    labels = coarse.labels.copy()
    labels[labels == 2] = 1
    labels[2:6, 2:6, 2:6] = 2
    write_volume(coarse.with_labels(labels), tmp_path / "labels_1mm.nrrd")
    with pytest.raises(GeometryError, match=r"labels_1mm\.nrrd.*within 5.0 mm.*got \d\d\.\d mm"):
        read_kidney_case(tmp_path)
    write_volume(coarse.with_labels(labels), tmp_path / "segmentation.nii.gz")
    (tmp_path / "labels_1mm.nrrd").unlink()
    with pytest.raises(GeometryError, match=r"segmentation\.nii\.gz.*within 5.0 mm"):
        read_kidney_case(tmp_path)


def test_a_tumour_beside_its_kidney_is_kept():
    labels = np.zeros((60, 40, 40), np.uint8)
    labels[5:35, 5:35, 5:35] = 1
    labels[37:49, 14:26, 14:26] = 2
    scan = LabelVolume(labels, np.eye(4), KIDNEY_NAMES)
    found, _ = affected_kidney(scan)
    assert found.volume_mm3("tumour") == scan.volume_mm3("tumour")
    assert found.volume_mm3("kidney") == scan.volume_mm3("kidney")
    assert kidney_surface(found).body_count == 2
    labels[37:39] = 0
    labels[0:2, 0, 0] = 1
    with pytest.raises(LabelError, match="tumour"):
        affected_kidney(LabelVolume(np.minimum(labels, 1), np.eye(4), KIDNEY_NAMES))


def test_a_tumour_that_voxels_do_not_show(tmp_path):
    labels = np.zeros((60, 60, 60), np.uint8)
    labels[5:55, 5:55, 5:55] = 1
    labels[30, 30, 30] = 2
    write_volume(LabelVolume(labels, np.diag([0.4, 0.4, 0.4, 1])), tmp_path / "segmentation.nii.gz")
    with pytest.raises(GeometryError, match=r"voxels of 1 mm, got one of 1 voxels of 0\.4 x 0\.4 x 0\.4 mm"):
        read_kidney_case(tmp_path)


def test_a_prepared_case_is_what_its_files_say(prepared, coarse):
    case = read_kidney_case(prepared)
    assert (case.name, case.side) == ("case_7", "left")
    assert case.anatomy.labels.tobytes() == coarse.labels.tobytes()
    assert case.given_surface is case.surface
    assert len(case.surface.vertices) < 5000
    assert np.allclose(case.swab, np.loadtxt(prepared / "swab.csv", delimiter=",", skiprows=1))
    assert list(case.summary().index)[:3] == ["side", "kidney_cm3", "tumour_cm3"]
    assert load_kidney(str(prepared)).name == "case_7"
    assert load_kidney(prepared / "labels_1mm.nrrd").name == "case_7"


def test_surface_and_swab_are_made_where_there_are_none(prepared, tmp_path):
    folder = copied(prepared, tmp_path)
    (folder / "kidney_with_tumour.stl").unlink()
    (folder / "swab.csv").unlink()
    case = read_kidney_case(folder)
    assert case.given_surface is None
    assert len(case.surface.vertices) > 8000
    distance = trimesh.proximity.closest_point(case.surface, case.swab)[1]
    assert distance.max() < 2.0


SWABS = {
    "two points": (lambda p: p[:2], "expected three or more points, got 2"),
    "nan": (lambda p: np.where(np.arange(len(p))[:, None] == 3, np.nan, p), r"finite.*got 1 of \d+ points"),
    "metres": (lambda p: p / 1000, r"got 0\.0\d+ mm \(are they in metres\?\)"),
    "centimetres": (lambda p: p / 10, r"got \d\.\d+ mm \(are they in centimetres\?\)"),
    "micrometres": (lambda p: p * 1000, r"\(are they in micrometres\?\)"),
    "one place": (lambda p: np.repeat(p[:1], 5, axis=0), "got 0 mm"),
    "a line": (lambda p: p[0] + np.linspace(0, 60, 30)[:, None] * [0.6, 0, 0.8], "do not lie on a line"),
    "another frame": (lambda p: p * [-1, -1, 1] + [30, 200, 0], "got .* mm, around .*aligned=False"),
}


@pytest.mark.parametrize("kind", SWABS)
def test_swabs_that_cannot_be(prepared, tmp_path, kind):
    folder = copied(prepared, tmp_path)
    change, message = SWABS[kind]
    points = np.loadtxt(folder / "swab.csv", delimiter=",", skiprows=1)
    write_swab(folder, change(points))
    with pytest.raises(GeometryError, match=message) as error:
        read_kidney_case(folder)
    assert "swab.csv" in str(error.value)
    if kind == "another frame":
        assert np.allclose(read_kidney_case(folder, aligned=False).swab, change(points))
    else:
        with pytest.raises(GeometryError, match=message):
            read_kidney_case(folder, aligned=False)


def test_swab_files_that_are_none(prepared, tmp_path):
    folder = copied(prepared, tmp_path)
    for text in ("a,b\n1,2\n", "", "x,y,z\n1,2,three\n"):
        (folder / "swab.csv").write_text(text)
        with pytest.raises(FileFormatError, match=r"swab\.csv.*columns x, y, z"):
            read_kidney_case(folder)
    (folder / "swab.csv").write_text("x_mm,y_mm,z_mm\n")
    with pytest.raises(GeometryError, match="got 0"):
        read_kidney_case(folder)


def _without_some(mesh):
    return trimesh.Trimesh(mesh.vertices, mesh.faces[3:], process=False)


def _with_a_fin(mesh):
    edge = mesh.faces[0][:2]
    vertices = np.vstack([mesh.vertices, mesh.vertices[edge].mean(axis=0) + 5])
    return trimesh.Trimesh(vertices, np.vstack([mesh.faces, [*edge, len(vertices) - 1]]), process=False)


SURFACES = {
    "holes": (_without_some, "edges at holes"),
    "a fin": (_with_a_fin, "1 edges that join more than two triangles"),
    "metres": (lambda m: m.copy().apply_scale(0.001), "in the frame of the labels, in mm"),
    "another frame": (lambda m: m.copy().apply_translation([0, 400.0, 0]), "in the frame of the labels"),
}


@pytest.mark.parametrize("kind", SURFACES)
def test_surfaces_that_cannot_be(prepared, tmp_path, kind):
    folder = copied(prepared, tmp_path)
    path = folder / "kidney_with_tumour.stl"
    change, message = SURFACES[kind]
    mesh = read_kidney_case(prepared).surface
    write_surface(change(mesh), path)
    with pytest.raises(GeometryError, match=message) as error:
        read_kidney_case(folder)
    assert path.name in str(error.value)


def test_an_empty_surface_file_and_one_inside_out(prepared, tmp_path):
    folder = copied(prepared, tmp_path)
    path = folder / "kidney_with_tumour.stl"
    mesh = read_kidney_case(prepared).surface
    path.write_bytes(b"\0" * 84)
    with pytest.raises(FileFormatError, match=r"kidney_with_tumour\.stl"):
        read_kidney_case(folder)
    inverted = mesh.copy()
    inverted.invert()
    write_surface(inverted, path)
    assert read_kidney_case(folder).surface.volume == pytest.approx(mesh.volume, rel=1e-5)


def test_label_files_that_are_not(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_kidney_case(tmp_path / "nowhere")
    labels = np.zeros((5, 5, 5), np.uint8)
    labels[1:4] = 1
    write_volume(LabelVolume(labels, np.eye(4), {"a": 0, "b": 1}), tmp_path / "k.nrrd")
    with pytest.raises(LabelError, match=r"k\.nrrd.*tumour"):
        read_kidney_case(tmp_path)
    write_volume(LabelVolume(labels * 2, np.eye(4)), tmp_path / "k.nrrd")
    with pytest.raises(LabelError, match=r"k\.nrrd.*kidney"):
        read_kidney_case(tmp_path)
    labels[2, 2, 2] = 2
    write_volume(LabelVolume(labels, np.eye(4)), tmp_path / "k.nrrd")
    assert load_kidney(tmp_path / "k.nrrd").anatomy.volume_mm3("tumour") == 1
    assert load_kidney(tmp_path / "k.nrrd").name == "k"
    assert read_kidney_case(tmp_path).side == ""
    assert read_kidney_case(tmp_path, labels="k.nrrd").anatomy.volume_mm3("tumour") == 1
    (tmp_path / "case.json").write_text('{"side": "upper"}')
    with pytest.raises(FileFormatError, match=r"case\.json.*'upper'"):
        read_kidney_case(tmp_path)
    with pytest.raises(InputError, match="is none of them"):
        load_kidney(tmp_path / "nowhere")


REAL = {  # exophytic share, largest section mm, swab points: as the set's own notes print them
    "case_00063": (0.07, (28.2, 25.7, 26.1), 659),
    "case_00071": (0.25, (33.6, 31.1, 29.0), 730),
    "case_00091": (0.47, (37.2, 37.2, 37.8), 670),
    "case_00101": (0.55, (27.0, 24.4, 26.5), 671),
}


@pytest.mark.parametrize("name", REAL)
def test_real_kidneys(name):
    case = load_kidney(real(f"kidney/{name}"))
    notes = json.loads((real(f"kidney/{name}") / "case.json").read_text())
    share, sections, points = REAL[name]
    assert (case.name, case.side) == (name, notes["side"])
    assert case.swab.shape == (points, 3)
    assert case.anatomy.volume_mm3("tumour") / 1000 == pytest.approx(notes["tumour_cm3"], abs=0.01)
    assert exophytic_share(case.anatomy) == pytest.approx(share, abs=0.006)
    assert np.allclose(tumour_sections(case.anatomy), sections, atol=0.1)
    assert len(case.surface.vertices) == notes["stl"]["kidney_vertices"]
    # Our surface and our swab, where there would be no files, are those of the files.
    own = kidney_surface(case.anatomy)
    assert own.is_watertight
    assert own.volume == pytest.approx(case.surface.volume, rel=0.01)
    swab = trace_swab(case.surface, case.tumour_centre)
    assert len(swab) == pytest.approx(points, rel=0.15)
    for a, b in ((swab, case.swab), (case.swab, swab)):
        assert np.quantile(cKDTree(a).query(b)[0], 0.95) < 3.0  # lines are 2.5 mm apart


def test_a_real_kidney_as_a_scan(tmp_path):
    """Labels of a real case, written with the challenge's axes and voxels: what comes back is that case."""
    original = load_kidney(real("kidney/case_00091"))
    labels, placed = scan_of(original.anatomy, CHALLENGE, with_other=False)
    write_scan(tmp_path / "segmentation.nii.gz", labels, placed)
    case = load_kidney(tmp_path)
    for name in ("kidney", "tumour"):
        assert case.anatomy.volume_mm3(name) == pytest.approx(original.anatomy.volume_mm3(name), rel=0.03)
    distance = cKDTree(case.surface.vertices).query(original.swab)[0]
    assert np.quantile(distance, 0.95) < 2.0
