"""A temporal bone from a seed and a few lengths."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from scipy import ndimage

from study.errors import GeometryError
from study.specimens.orientation import lateral_direction
from study.specimens.otic import carve_labyrinth, centre_lines, inner_canal, ossicles
from study.specimens.parameters import TemporalBoneParameters
from study.specimens.shapes import Grid, carve_ellipsoid, carve_tube, random_field, swept
from study.volumes import LabelVolume

#: Labels of a procedural temporal bone.
ANATOMY_NAMES = {
    "air": 0,
    "bone": 1,
    "air_cells": 2,
    "middle_ear": 3,
    "external_auditory_canal": 4,
    "facial_nerve": 5,
    "chorda_tympani": 6,
    "labyrinth": 7,
    "internal_auditory_canal": 8,
    "sigmoid_sinus": 9,
    "dura": 10,
    "intracranial": 11,
    "malleus": 12,
    "incus": 13,
    "stapes": 14,
    "carotid_artery": 15,
    "temporomandibular_joint": 16,
}

#: mm of empty space lateral of the bone, for a burr that starts outside.
LATERAL_AIR = 13.0
#: mm of solid bone that air cells leave around a structure.
_WALL = 1.0
#: Corners of the lattices of the air cells' fields: wide enough for every size, so that size does not
#: change the noise.
_LATTICE = ((-14.0, -18.0, -60.0), (60.0, 60.0, 40.0))
_FAR = np.float32(9.0)


def temporal_bone(
    parameters: TemporalBoneParameters | None = None, seed: int = 0, spacing: float = 0.4
) -> LabelVolume:
    """Build a segmented temporal bone.

    Bone between the outer surface, the middle fossa above and the posterior fossa behind; in it the
    otic capsule, the nerves as swept splines, the ear canals, the sinus; what is left of the mastoid
    is honeycombed by a thresholded smooth random field, of which the cells that reach the antrum are kept.

    Parameters
    ----------
    parameters : TemporalBoneParameters, optional
    seed : int
        Of the roughness of the surfaces and the air cells. The fields are fixed in mm: another
        spacing shows the same bone.
    spacing : float
        mm of the cubic voxels, 0.2 to 1.

    Returns
    -------
    LabelVolume
        With `ANATOMY_NAMES`; LPS, the origin at the dome of the lateral semicircular canal. The same
        parameters, seed and spacing give the same bytes.

    Raises
    ------
    GeometryError
        If the spacing is outside its range.
    """
    p = TemporalBoneParameters() if parameters is None else parameters
    if not 0.2 <= spacing <= 1.0:
        raise GeometryError(f"spacing: expected 0.2 to 1 mm, got {spacing}")
    depth = p.mastoid_depth * p.size
    top = max(19.0, 17.0 * p.size + 3.0)
    bottom = -max(18.0, p.mastoid_height * p.size) - 3.0
    back = max(24.0, p.sinus_distance * p.size + 2 * p.sinus_radius + 2.0, 17.0 * p.size + 3.0)
    low, high = (-23.0, -22.0, bottom), (depth + 2.0 + LATERAL_AIR, back, top)
    grid = Grid.covering(low, high, spacing)
    lines = centre_lines(p, depth)

    walls = _surfaces(p, grid, depth, seed, low, high)
    labels = np.zeros(grid.shape, np.uint8)
    _paint_bone(labels, grid, p, walls, lines)
    structures = _distances(p, grid, lines)
    _paint_air_cells(labels, grid, p, walls, structures, seed)
    _paint_structures(labels, grid, p, walls, structures)

    if p.side == "left":
        labels = labels[::-1]
    affine = np.diag([spacing, spacing, spacing, 1.0])
    lateral = grid.lateral[0] if p.side == "right" else grid.lateral[-1]
    affine[:3, 3] = (lateral_direction(p.side)[0] * lateral, grid.posterior[0], grid.superior[0])
    return LabelVolume(np.ascontiguousarray(labels), affine, ANATOMY_NAMES)


def _rng(seed: int, part: int) -> np.random.Generator:
    # One stream a part: more detail in one part does not change the others.
    return np.random.default_rng([int(seed), part])


def _surfaces(p, grid: Grid, depth: float, seed: int, low, high) -> SimpleNamespace:
    """Outer surface, skull base, floor of the middle fossa, wall of the posterior fossa: heights in mm."""
    L, P, S = grid.axes
    # Lattices of the roughness are the same whatever the grid's size.
    wide = (-60.0, 80.0)

    def rough(part: int, axes, pitch: float) -> np.ndarray:
        return random_field(_rng(seed, part), axes, pitch, (wide[0],) * 2, (wide[1],) * 2)

    def beyond(x, edge):
        return np.maximum(x - edge, 0)

    outer = (
        depth
        - 0.02 / p.size * beyond(-S, 2 * p.size)[None] ** 2
        - 0.012 / p.size * beyond(P, 6 * p.size)[:, None] ** 2
        - 0.02 * beyond(-P, 9)[:, None] ** 2
        + 0.45 * rough(1, (P, S), 6.0)
    )
    tip = max(18.0, p.mastoid_height * p.size)
    process = (
        -tip + 0.09 / p.size * (L[:, None] - 0.5 * depth) ** 2 + 0.07 / p.size * (P[None] - 8.0 * p.size) ** 2
    )
    base = -15.5 - 5.0 / (1 + np.exp(-(P[None] - 14.0) / 2)) + 0.5 * rough(2, (L, P), 5.0)
    base = base + 0.45 * beyond(L, 0.35 * depth)[:, None]
    under = np.minimum(process, base)
    steep = (20.0 - p.tegmen_height) / (depth - 7.0) ** 2
    squama = 2 * steep * beyond(L, 4)[:, None]
    middle = (
        p.tegmen_height
        + 0.2 * P[None]
        - 0.4 * beyond(-P, 5)[None]
        + steep * beyond(L, 4)[:, None] ** 2
        + 3.0 * np.exp(-((L[:, None] + 4.6) ** 2 + (P[None] + 2.4) ** 2) / 18)
        + 0.4 * rough(3, (L, P), 5.0)
    )
    posterior = (
        p.fossa_distance
        + 0.62 * 3 * np.logaddexp(0, (L[:, None] + 0.5) / 3)
        - 0.12 * beyond(-L, 5)[:, None]
        - 0.9 * beyond(-L, 14)[:, None]
        + 0.45 * beyond(-S, 2)[None]
        + 0.35 * rough(4, (L, S), 5.0)
    )
    return SimpleNamespace(
        outer=outer.astype(np.float32),
        under=under.astype(np.float32),
        middle=middle.astype(np.float32),
        middle_slope=np.sqrt(1 + squama**2 + 0.04).astype(np.float32),
        posterior=posterior.astype(np.float32),
    )


def _paint_bone(labels: np.ndarray, grid: Grid, p, walls: SimpleNamespace, lines) -> None:
    L, P, S = grid.open_axes
    outer = walls.outer[None] - L
    walls.inward = outer
    above = (walls.middle[:, :, None] - S) / walls.middle_slope[:, :, None]
    np.maximum(above, 3.8 - outer, out=above)
    behind = (walls.posterior[:, None, :] - P) / np.float32(1.2)
    np.maximum(behind, 4.8 - outer, out=behind)
    walls.brain = np.minimum(above, behind)
    solid = (outer > 0) & (walls.under[:, :, None] < S)
    labels[solid] = ANATOMY_NAMES["bone"]

    depth = p.mastoid_depth * p.size
    extra = np.full(grid.shape, _FAR, np.float32)
    canal = lines.external_auditory_canal
    carve_tube(extra, grid, canal, lines.canal_radii + 1.8)
    extra[outer < -0.5] = _FAR
    zygoma = [(0.72 * depth, -9.0, -1.5), (0.86 * depth, -16.0, -2.0), (0.95 * depth, -30.0, -3.0)]
    carve_tube(extra, grid, swept(zygoma, 8), np.linspace(3.2, 2.2, 8))
    styloid = [(-2.0, 1.0, -14.0), (-3.0, -1.0, -26.0)]
    carve_tube(extra, grid, np.array(styloid), np.array([2.2, 1.2]))
    labels[(extra < 0) & (labels == 0)] = ANATOMY_NAMES["bone"]

    # The joint's fossa lies in front of the ear canal; the condyle stands in it.
    front = canal[len(canal) // 2, 1] - 1.05 * p.canal_radius - 2.4
    fossa, condyle = np.full(grid.shape, _FAR, np.float32), np.full(grid.shape, _FAR, np.float32)
    across, down = 0.5 * depth, -p.canal_drop
    carve_ellipsoid(fossa, grid, (across, front - 7.0, down - 9.0), (0.55 * depth, 7.0, 9.5))
    carve_tube(fossa, grid, np.array([(across, front - 7.5, -14.0), (across, front - 9.0, -40.0)]), 8.0)
    carve_ellipsoid(condyle, grid, (across, front - 7.5, down - 7.5), (0.36 * depth, 4.0, 5.5))
    carve_tube(condyle, grid, np.array([(across, front - 7.5, -14.0), (across + 3, front - 9.0, -40.0)]), 3.2)
    labels[(fossa < 0) & (extra > -2.4)] = ANATOMY_NAMES["air"]
    labels[(condyle < 0) & (labels == ANATOMY_NAMES["air"])] = ANATOMY_NAMES["temporomandibular_joint"]

    labels[(walls.brain < 0) & solid] = ANATOMY_NAMES["intracranial"]
    labels[(walls.brain < 0) & (walls.brain > -1.2) & solid] = ANATOMY_NAMES["dura"]


def _distances(p, grid: Grid, lines) -> dict[str, np.ndarray]:
    """Signed distance (mm, cut off a little beyond the wall) from every structure inside the bone."""

    def empty() -> np.ndarray:
        return np.full(grid.shape, _FAR, np.float32)

    reach = _WALL + 0.5
    out = {name: empty() for name in ("middle_ear", "antrum")}
    o = p.otic_scale
    for centre, semi_axes in (((-4.7, -5.4, -4.6), (2.3, 3.8, 4.8)), ((-1.6, -5.0, -0.2), (2.6, 3.4, 2.4))):
        carve_ellipsoid(out["middle_ear"], grid, o * np.array(centre), o * np.array(semi_axes))
    carve_tube(out["middle_ear"], grid, o * np.array([(-6.0, -8.0, -6.5), (-15.0, -21.0, -11.0)]), 1.3)
    carve_tube(out["antrum"], grid, np.array([(-0.2, -2.6, 0.9), (2.6, 2.6, 1.8)]), 1.8)
    carve_ellipsoid(out["antrum"], grid, (3.0, 2.8, 1.6), (2.9, 3.3, 2.5))

    tubes = {
        "facial_nerve": (lines.facial_nerve, p.nerve_radius),
        "chorda_tympani": (lines.chorda_tympani, 0.4),
        "external_auditory_canal": (lines.external_auditory_canal, lines.canal_radii),
        "sigmoid_sinus": (lines.sigmoid_sinus, lines.sinus_radii),
        "carotid_artery": (lines.carotid_artery, 3.4),
        "internal_auditory_canal": inner_canal(o),
    }
    for name, (points, radii) in tubes.items():
        out[name] = empty()
        carve_tube(out[name], grid, points, radii, reach)
    out["labyrinth"] = empty()
    carve_labyrinth(out["labyrinth"], grid, o, reach)
    for name, parts in ossicles(o).items():
        out[name] = empty()
        for points, radius in parts:
            carve_tube(out[name], grid, points, radius)
    return out


def _paint_air_cells(labels, grid: Grid, p, walls: SimpleNamespace, structures: dict, seed: int) -> None:
    """Honeycomb: septa are where a random field is near zero, so that cells are wide and septa thin."""
    depth = p.mastoid_depth * p.size
    box = grid.box((-9.0, -13.0, -40.0), (depth, 40.0, 30.0))
    part = grid.within(box)
    L, P, S = part.open_axes
    wall = np.float32(_WALL)
    room = labels[box] == ANATOMY_NAMES["bone"]
    room &= walls.inward[box] > p.cortex_thickness
    room &= walls.brain[box] > wall
    room &= walls.under[box[:2]][:, :, None] + p.cortex_thickness < S
    # Cells spread from the antrum backwards and down, forwards only above the ear canal.
    ragged = random_field(_rng(seed, 8), part.axes, 4.0, *_LATTICE)
    room &= ragged * np.float32(2.0) + L > -4.0
    room &= ragged * np.float32(2.0) + P > -p.canal_lead - 5.0
    room &= (-p.canal_drop + 1.0 < S) | (-p.canal_lead + 2.0 < P)
    for name, margin in (
        ("facial_nerve", 0.8),
        ("chorda_tympani", 0.4),
        ("external_auditory_canal", 1.2),
        ("sigmoid_sinus", wall),
        ("labyrinth", wall),
        ("internal_auditory_canal", wall),
        ("middle_ear", 0.8),
    ):
        room &= structures[name][box] > margin
    antrum = (structures["antrum"][box] < 0) & (structures["labyrinth"][box] > 0.8)
    antrum &= (structures["facial_nerve"][box] > 0.8) & (walls.brain[box] > 0.8)

    pitch = 0.62 * p.cell_size
    septa = np.abs(random_field(_rng(seed, 5), part.axes, pitch, *_LATTICE))
    across = np.abs(random_field(_rng(seed, 6), part.axes, pitch, *_LATTICE))
    gaps = random_field(_rng(seed, 7), part.axes, pitch, *_LATTICE)
    # A second set of septa divides the folds of the first into cells; its gaps join them.
    np.minimum(septa, 0.8 * across + np.maximum(gaps, 0) * np.float32(0.9), out=septa)
    cells = antrum.copy()
    if p.pneumatisation > 0 and room.any():
        cells |= room & (septa > np.quantile(septa[room], 1 - p.pneumatisation))
    found, _ = ndimage.label(cells)
    kept = np.unique(found[antrum])
    keep = np.zeros(found.max() + 1, bool)
    keep[kept[kept > 0]] = True
    labels[box][keep[found]] = ANATOMY_NAMES["air_cells"]


def _paint_structures(labels: np.ndarray, grid: Grid, p, walls: SimpleNamespace, structures: dict) -> None:
    inside = {name: distance < 0 for name, distance in structures.items()}
    brain = (labels == ANATOMY_NAMES["intracranial"]) | (labels == ANATOMY_NAMES["dura"])
    # The canal ends where the skin of the side of the head begins.
    inside["external_auditory_canal"] &= walls.inward > -2.0
    inside["internal_auditory_canal"] &= ~brain
    inside["middle_ear"] &= ~brain & (walls.brain > 0.6)
    inside["sigmoid_sinus"] &= walls.inward > 1.5
    inside["carotid_artery"] &= labels == ANATOMY_NAMES["bone"]
    # From hollow to delicate: what comes later wins.
    for name in (
        "carotid_artery",
        "sigmoid_sinus",
        "middle_ear",
        "external_auditory_canal",
        "internal_auditory_canal",
        "labyrinth",
        "malleus",
        "incus",
        "stapes",
        "chorda_tympani",
        "facial_nerve",
    ):
        labels[inside[name]] = ANATOMY_NAMES[name]
