"""Procedural kidneys: the same every time, small renal masses, surfaces and swabs a registration can use."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, cKDTree

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.specimens import (
    KIDNEY_NAMES,
    KidneyParameters,
    SwabRule,
    exophytic_share,
    kidney,
    kidney_case,
    kidney_catalogue,
    kidney_surface,
    load_kidney,
    reachable_vertices,
    trace_swab,
    tumour_sections,
)
from study.specimens import kidney_catalogue as catalogue_function
from study.specimens.kidney_depth import depth_map
from study.specimens.kidney_room import KIDNEY_ROOM, TUMOUR_ROOM
from study.volumes import LabelVolume

NAMES = ("K1", "K2", "K3", "K4")


def room(volume, name):
    """(3, 2) mm from the outermost voxels of a label to the ends of the grid."""
    indices = np.argwhere(volume.mask(name))
    ends = np.array([indices.min(axis=0), np.array(volume.shape) - 1 - indices.max(axis=0)])
    return ends.T * volume.spacing[:, None]


def test_catalogue_is_that_of_the_issue():
    assert kidney_catalogue() == list(NAMES)
    with pytest.raises(InputError, match=r"K1, K2, K3, K4.*'K9'"):
        kidney_case("K9")


@pytest.mark.parametrize("name", NAMES)
def test_a_named_kidney_is_a_small_renal_mass_with_room(name):
    case = kidney_case(name)
    assert case.name == name
    assert case.anatomy.names == KIDNEY_NAMES
    assert np.allclose(case.anatomy.affine[:3, :3], np.eye(3))  # LPS, 1 mm
    assert (room(case.anatomy, "tumour") >= TUMOUR_ROOM).all()
    assert (room(case.anatomy, "kidney") >= KIDNEY_ROOM).all()
    assert 20 <= tumour_sections(case.anatomy).max() <= 40
    # Adult kidneys; the four real ones have 153 to 252 cm^3.
    assert 120 < case.anatomy.volume_mm3("kidney") / 1000 < 260


def test_tumours_go_from_exophytic_to_endophytic():
    shares = [exophytic_share(kidney_case(name).anatomy) for name in NAMES]
    assert shares == sorted(shares, reverse=True)
    assert np.allclose(shares, [0.55, 0.4, 0.2, 0.05], atol=0.05)
    sizes = [tumour_sections(kidney_case(name).anatomy).max() for name in NAMES]
    assert min(sizes) < 26
    assert max(sizes) > 35


@pytest.mark.parametrize("name", NAMES)
def test_the_side_is_that_of_the_body(name):
    """The hilum, where the hull is farthest from the surface, faces the spine and forwards."""
    case = kidney_case(name)
    hull = trimesh.Trimesh(*_hull(case.surface))
    tree = cKDTree(case.surface.vertices)
    distance, _ = tree.query(hull.triangles_center)
    outward = hull.face_normals[distance > 0.6 * distance.max()].mean(axis=0)
    medial = 1.0 if case.side == "right" else -1.0  # +x is to the left
    assert outward[0] * medial > 0
    assert outward[1] < 0
    # The upper pole lies behind the lower one and nearer to the spine.
    upper, lower = (case.surface.vertices[f(case.surface.vertices[:, 2])] for f in (np.argmax, np.argmin))
    assert upper[1] > lower[1]
    assert (upper[0] - lower[0]) * medial > 0


def _hull(surface):
    hull = ConvexHull(surface.vertices)
    centre = surface.vertices.mean(axis=0)
    faces = hull.simplices.copy()
    corners = surface.vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = np.einsum("ij,ij->i", normal, corners[:, 0] - centre) < 0
    faces[inward] = faces[inward][:, ::-1]
    fine = trimesh.remesh.subdivide_to_size(surface.vertices, faces, 4.0)
    return fine[0], fine[1]


def test_the_same_bytes_every_time():
    once, again = kidney(KidneyParameters(), 5, 2.0), kidney(KidneyParameters(), 5, 2.0)
    assert once.labels.tobytes() == again.labels.tobytes()
    assert np.array_equal(once.affine, again.affine)
    other = kidney(KidneyParameters(), 6, 2.0)
    assert other.shape != once.shape or (other.labels != once.labels).any()
    parameters = KidneyParameters.drawn(3, "left", tumour_diameter=20.0)
    assert parameters == KidneyParameters.drawn(3, "left", tumour_diameter=20.0)
    assert parameters != KidneyParameters.drawn(4, "left", tumour_diameter=20.0)


def test_swab_and_surface_are_the_same_bytes_every_time():
    case = kidney_case("K4")
    again = replace(case)
    assert again.swab is not case.swab
    assert again.swab.tobytes() == case.swab.tobytes()
    assert again.surface.vertices.tobytes() == case.surface.vertices.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        case.swab[0] = 0


def test_another_spacing_shows_the_same_kidney():
    volumes = [kidney(KidneyParameters(), 2, spacing) for spacing in (1.5, 2.2)]
    for name in ("kidney", "tumour"):
        fine, coarse = (volume.volume_mm3(name) for volume in volumes)
        assert coarse == pytest.approx(fine, rel=0.02)
        centres = [volume.points(np.argwhere(volume.mask(name))).mean(axis=0) for volume in volumes]
        assert np.allclose(*centres, atol=0.2)
    fine, coarse = (kidney_surface(volume) for volume in volumes)
    some = coarse.vertices[:: len(coarse.vertices) // 400]
    distance = trimesh.proximity.closest_point(fine, some)[1]
    assert np.quantile(distance, 0.95) < 0.5 * 2.2  # half a coarse voxel


def test_the_other_side_is_the_mirror_image():
    right, left = (kidney(KidneyParameters(side=side), 7, 2.0) for side in ("right", "left"))
    assert np.array_equal(left.labels, right.labels[::-1])
    x = [volume.points(np.argwhere(volume.mask("tumour")))[:, 0].mean() for volume in (right, left)]
    assert x[0] == pytest.approx(-x[1], abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_surfaces_are_closed_and_of_the_labels(name):
    case = kidney_case(name)
    assert case.surface.is_watertight
    assert case.surface.is_winding_consistent
    assert (np.unique(case.surface.edges_sorted, axis=0, return_counts=True)[1] == 2).all()
    assert 8000 <= len(case.surface.vertices) <= 11000
    assert case.surface.volume == pytest.approx(case.anatomy.volume_mm3("kidney", "tumour"), rel=0.02)
    # Vertices lie between voxels of one label and the other: within a voxel of the outermost centres.
    mask = case.anatomy.mask("kidney", "tumour")
    near = cKDTree(case.anatomy.points(np.argwhere(mask))).query(case.surface.vertices)[0]
    assert near.max() < 1.8


@pytest.mark.parametrize("name", NAMES)
def test_swabs_are_traced_on_the_surface(name):
    case = kidney_case(name)
    rule = replace(case.swab_rule, noise_mm=0.0)
    clean = trace_swab(case.surface, case.tumour_centre, rule)
    assert len(clean) == len(case.swab)
    assert 630 <= len(clean) <= 770
    distance = trimesh.proximity.closest_point(case.surface, clean)[1]
    assert np.sqrt(np.mean(distance**2)) < 0.05
    noise = case.swab - clean
    assert np.sqrt((noise**2).sum(axis=1).mean()) == pytest.approx(0.3 * np.sqrt(3), rel=0.06)
    assert abs(noise.mean()) < 0.03
    # Steps of 1.5 mm along a line, in the tracing order.
    steps = np.linalg.norm(np.diff(clean, axis=0), axis=1)
    assert np.median(steps) == pytest.approx(1.5, abs=0.02)
    assert np.mean(np.abs(steps - 1.5) < 0.1) > 0.9


@pytest.mark.parametrize("name", NAMES)
def test_swabs_see_half_of_the_front(name):
    """The traced patch is on the side that is seen, holds half of it, and is where the tumour is."""
    case = kidney_case(name)
    rule = SwabRule(noise_mm=0.0)
    whole = trace_swab(case.surface, case.tumour_centre, replace(rule, share=1.0, points=1400))
    part = trace_swab(case.surface, case.tumour_centre, rule)
    # As many points for half the area as twice as many for all of it: the same density.
    density = [np.median(cKDTree(points).query(points, k=5)[0][:, 4]) for points in (whole, part)]
    assert density[0] == pytest.approx(density[1], rel=0.15)
    covered = np.mean(cKDTree(part).query(whole)[0] < 3.0)
    assert 0.42 < covered < 0.6
    view = depth_map(case.surface, (0, 1, 0), 0.5)
    flat = part @ view.axes[:2].T
    seen, _ = view.surface_points(flat, np.isfinite(view.depth))
    assert np.abs(seen - part)[:, 1].max() < 1.0  # what is hidden lies many mm behind
    other = trace_swab(case.surface, case.surface.bounds[0 if case.tumour_centre[2] > 0 else 1], rule)
    away = [np.linalg.norm(points.mean(axis=0) - case.tumour_centre) for points in (part, other)]
    assert away[0] < away[1] + 1.0


def test_depth_of_a_ball_is_that_of_the_formula():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=20.0)
    for looking in ((0, 1, 0), (0, -2, 0), (1, 1, 0), (0, 0, 1), (0.3, -0.2, 0.8)):
        view = depth_map(ball, looking, 0.5)
        flat = view.centres(np.isfinite(view.depth))
        expected = -np.sqrt(np.maximum(20.0**2 - (flat**2).sum(axis=1), 0))
        inner = np.linalg.norm(flat, axis=1) < 18
        assert np.abs(view.depth[np.isfinite(view.depth)] - expected)[inner].max() < 0.03
        assert np.allclose(view.axes @ view.axes.T, np.eye(3))
        assert np.linalg.det(view.axes) == pytest.approx(-1)  # right, up, away from the viewer
        assert np.pi * 18**2 * 4 < np.isfinite(view.depth).sum() < np.pi * 20.5**2 * 4


def test_depth_is_that_of_rays():
    """Brute force: every ray against every triangle."""
    surface = kidney_surface(kidney(spacing=3.0), 2.0, 6.0)
    view = depth_map(surface, (0.2, 1.0, -0.1), 4.0)
    flat = view.centres(np.ones(view.depth.shape, bool))
    forward = view.axes[2]
    found = np.full(len(flat), np.inf)
    for a, b, c in surface.triangles:
        system = np.column_stack([b - a, c - a, -forward])
        if abs(np.linalg.det(system)) < 1e-9:
            continue
        s, t, depth = np.linalg.solve(system, (flat @ view.axes[:2] - a).T)
        hit = (s >= 0) & (t >= 0) & (s + t <= 1)
        found[hit] = np.minimum(found[hit], depth[hit])
    found[np.isinf(found)] = np.nan
    assert np.isfinite(found).sum() > 100
    assert np.allclose(view.depth.ravel(), found, atol=1e-6, equal_nan=True)


def test_a_swab_of_a_ball_has_the_area_asked_for():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=30.0)
    rule = SwabRule(noise_mm=0.0, slope_deg=60.0, share=0.5, points=900)
    points = trace_swab(ball, np.array([0.0, 0.0, 100.0]), rule)
    assert np.allclose(np.linalg.norm(points, axis=1), 30, atol=0.1)
    tilt = np.rad2deg(np.arccos(-points[:, 1] / 30))
    assert 57 < tilt.max() < 61
    assert len(points) == pytest.approx(900, rel=0.07)


def test_a_swab_reaches_all_but_the_sinus():
    """A ball with a narrow bore: its outside is reached, the bottom of the bore is not."""
    i, j, k = np.indices((64, 64, 64)) - 31.5
    bored = (i**2 + j**2 + k**2 <= 28**2) & ~((i**2 + j**2 <= 5**2) & (k > -5))
    volume = LabelVolume(bored.astype(np.uint8), np.diag([1, 1, 1, 1.0]), KIDNEY_NAMES)
    surface = kidney_surface(volume)
    reached = reachable_vertices(surface, volume)
    away = np.linalg.norm(surface.vertices - 31.5, axis=1)
    assert reached[away > 27].all()
    assert not reached[away < 22].any()
    assert (away < 22).sum() > 100
    for name in ("ball_mm", "tolerance_mm"):
        with pytest.raises(InputError, match=name):
            reachable_vertices(surface, volume, **{name: 0.0})


@pytest.mark.parametrize("name", NAMES)
def test_swabs_lie_on_what_they_reach(name):
    case = kidney_case(name)
    assert 0.85 < case.reachable.mean() < 0.99
    near = [
        cKDTree(points).query(case.swab)[0]
        for points in (case.surface.vertices, case.surface.vertices[case.reachable])
    ]
    assert np.mean(near[1] - near[0] < 0.5) > 0.95


def test_measures_of_a_ball_in_a_half_space():
    shape = (60, 60, 60)
    i, j, k = np.indices(shape)
    labels = (k < 30).astype(np.uint8)
    ball = (i - 30) ** 2 + (j - 30) ** 2 + (k - 29.5) ** 2 <= 15**2
    labels[ball] = 2
    volume = LabelVolume(labels, np.diag([1, 1, 1, 1.0]), KIDNEY_NAMES)
    assert exophytic_share(volume) == pytest.approx(0.5, abs=0.02)
    assert np.allclose(tumour_sections(volume), [31, 31, 31], atol=1.0)
    double = LabelVolume(labels, np.diag([2, 2, 2, 1.0]), KIDNEY_NAMES)
    assert np.allclose(tumour_sections(double), 2 * tumour_sections(volume))
    empty = LabelVolume(np.minimum(labels, 1), np.eye(4), KIDNEY_NAMES)
    for measure in (exophytic_share, tumour_sections):
        with pytest.raises(LabelError, match="tumour"):
            measure(empty)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"length": 20.0}, "length"),
        ({"tumour_diameter": 41.0}, "tumour_diameter"),
        ({"tumour_depth": np.nan}, "tumour_depth"),
        ({"tumour_height": 1.2}, "tumour_height"),
        ({"side": "up"}, "side"),
    ],
)
def test_parameters_beyond_anatomy(values, named):
    with pytest.raises(InputError, match=named):
        KidneyParameters(**values)


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ({"looking": (0, 0, 0)}, "looking"),
        ({"looking": (0, np.nan, 0)}, "looking"),
        ({"slope_deg": 95}, "slope_deg"),
        ({"share": 0}, "share"),
        ({"points": 2}, "points"),
        ({"noise_mm": -1}, "noise_mm"),
        ({"pixel_mm": np.nan}, "pixel_mm"),
    ],
)
def test_swab_rules_that_are_none(values, named):
    with pytest.raises(InputError, match=named):
        SwabRule(**values)


def test_no_swab_of_what_is_no_surface():
    ball = trimesh.creation.icosphere(subdivisions=3, radius=30.0)
    with pytest.raises(GeometryError, match="without triangles"):
        trace_swab(trimesh.Trimesh(), np.zeros(3))
    with pytest.raises(GeometryError, match="3 edges at holes"):
        trace_swab(trimesh.Trimesh(ball.vertices, ball.faces[1:], process=False), np.zeros(3))
    doubled = np.vstack([ball.faces, ball.faces[:1]])
    with pytest.raises(GeometryError, match="3 edges that join more than two"):
        trace_swab(trimesh.Trimesh(ball.vertices, doubled, process=False), np.zeros(3))
    with pytest.raises(InputError, match="near"):
        trace_swab(ball, np.array([0, np.nan, 0]))
    with pytest.raises(InputError, match="near"):
        trace_swab(ball, np.zeros(2))
    upright = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])
    for radius, message in ((1.0, "three points or more"), (0.3, "not steeper than 65")):
        spike = trimesh.creation.cone(radius=radius, height=60.0, transform=upright)
        with pytest.raises(GeometryError, match=message):
            trace_swab(spike, np.zeros(3))


def test_spacings_that_are_none():
    for spacing in (0.0, 0.1, 5.0, np.nan):
        with pytest.raises(GeometryError, match="spacing"):
            kidney(spacing=spacing)


def test_a_broken_catalogue(monkeypatch, tmp_path):
    from study.specimens.kidney_catalogue import _entries

    bad = tmp_path / "kidneys.csv"
    bad.write_text("name,side\nK1,right\n")
    monkeypatch.setitem(catalogue_function.__globals__, "data_path", lambda *parts: bad)
    with pytest.raises(FileFormatError, match=r"kidneys\.csv.*tumour_diameter"):
        _entries.__wrapped__()


def test_load_kidney_knows_names(monkeypatch):
    assert load_kidney("K2") is kidney_case("K2")
    with pytest.raises(InputError, match=r"K1 to K4.*'nowhere'"):
        load_kidney("nowhere")
    with pytest.raises(InputError, match="K1 to K4"):
        load_kidney("")
