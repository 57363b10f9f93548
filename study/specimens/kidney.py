"""A kidney with a tumour from a seed and a few lengths."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from study.errors import GeometryError
from study.specimens.kidney_parameters import KidneyParameters
from study.specimens.kidney_room import with_room
from study.specimens.orientation import lateral_direction
from study.specimens.shapes import Grid, carve_tube, random_field
from study.volumes import LabelVolume

#: Labels of a kidney.
KIDNEY_NAMES = {"background": 0, "kidney": 1, "tumour": 2}

#: Corners of the lattices of the random fields, wide enough for every kidney: another kidney or spacing
#: does not change the noise.
_LATTICE = ((-110.0,) * 3, (110.0,) * 3)
_LOBES = (15.0, 7.0)  # mm between the points of the lattices of large and small lobes
_SMALL_LOBES = 0.3  # height of the small lobes as a share of that of the large ones
_SWELL = 10.0  # mm; farther than lobes and claw reach beyond the smooth shapes
_LIP = 4.0  # mm; radius of the rounding of the hilum's lips, about
_CLAW = 5.0  # mm; the same between kidney and tumour
_POLE_POWER = 2.5  # an ellipsoid has 2; more makes fuller poles


def kidney(parameters: KidneyParameters | None = None, seed: int = 0, spacing: float = 1.0) -> LabelVolume:
    """Build a segmented kidney with one tumour.

    A bent, tapered ellipsoid from which the sinus is hollowed, with lobes from smooth random fields;
    the tumour is a lobed ball at a stated depth under the capsule.

    Parameters
    ----------
    parameters : KidneyParameters, optional
    seed : int
        Of the lobes. The fields are fixed in mm: another spacing shows the same kidney.
    spacing : float
        mm of the cubic voxels, 0.4 to 3.

    Returns
    -------
    LabelVolume
        With `KIDNEY_NAMES`; LPS, the origin about the kidney's middle, with the room that `with_room`
        gives. The same parameters, seed and spacing give the same bytes.

    Raises
    ------
    GeometryError
        If the spacing is outside its range.
    """
    p = KidneyParameters() if parameters is None else parameters
    if not 0.4 <= spacing <= 3.0:
        raise GeometryError(f"spacing: expected 0.4 to 3 mm, got {spacing}")
    centre, radius = _tumour_centre(p), 0.5 * p.tumour_diameter
    around = radius + _SWELL
    half = np.array([0.5 * p.width + p.bend, 0.5 * p.thickness, 0.5 * p.length]) + _SWELL
    corner = half @ np.abs(_axes(p))
    grid = Grid.covering(np.minimum(-corner, centre - around), np.maximum(corner, centre + around), spacing)
    body = _body(p, *_local(p, grid.open_axes))
    for part, (pitch, share) in enumerate(zip(_LOBES, (1.0, _SMALL_LOBES), strict=True)):
        body -= np.float32(share * p.lobe_height) * _lobes(seed, part, grid, pitch)
    calyces = np.full(grid.shape, np.float32(_LIP), np.float32)
    for points, radii in _calyces(p):
        carve_tube(calyces, grid, points @ _axes(p), radii, _LIP)
    body = _smooth_maximum(body, -calyces, _LIP)

    box = grid.box(centre - around, centre + around)
    near = grid.within(box)
    tumour = np.sqrt(sum((axis - c) ** 2 for axis, c in zip(near.open_axes, centre, strict=True)))
    tumour -= radius + np.float32(p.tumour_lobe_height) * _lobes(seed, len(_LOBES), near, 0.6 * radius)
    # Parenchyma is drawn up a little where the tumour leaves it.
    body[box] = -_smooth_maximum(-body[box], -tumour, _CLAW)
    labels = (body < 0).astype(np.uint8)
    labels[box][tumour < 0] = KIDNEY_NAMES["tumour"]

    if p.side == "left":
        labels = labels[::-1]
    affine = np.diag([spacing, spacing, spacing, 1.0])
    lateral = grid.lateral[0] if p.side == "right" else grid.lateral[-1]
    affine[:3, 3] = (lateral_direction(p.side)[0] * lateral, grid.posterior[0], grid.superior[0])
    return with_room(LabelVolume(np.ascontiguousarray(labels), affine, KIDNEY_NAMES))


def _lobes(seed: int, part: int, grid: Grid, pitch: float) -> np.ndarray:
    # One stream a part: more detail in one part does not change the others.
    return random_field(np.random.default_rng([int(seed), part]), grid.axes, pitch, *_LATTICE)


def _axes(p: KidneyParameters) -> np.ndarray:
    """(3, 3) unit vectors, one a row, in (lateral, posterior, superior): convex border, back, upper pole."""
    medial, back, turn = np.deg2rad([p.medial_tilt_deg, p.posterior_tilt_deg, p.hilum_turn_deg])
    upper = np.array([-np.tan(medial), np.tan(back), 1.0])
    upper /= np.linalg.norm(upper)
    # The hilum faces forwards, hence the convex border backwards.
    border = np.array([np.cos(turn), np.sin(turn), 0.0])
    border -= (border @ upper) * upper
    border /= np.linalg.norm(border)
    return np.array([border, np.cross(upper, border), upper])


def _local(p: KidneyParameters, axes) -> list[np.ndarray]:
    x, y, z = axes
    return [np.float32(a) * x + np.float32(b) * y + np.float32(c) * z for a, b, c in _axes(p)]


def _body(p: KidneyParameters, u, v, w) -> np.ndarray:
    """About the signed distance (mm, negative inside) from the smooth kidney, in its own axes."""
    t = 2 * w / p.length
    power = np.abs(t) ** (_POLE_POWER - 1)
    # Poles lean to the hilum; the mean over the length stays where it is.
    across = u + p.bend * (t**2 - 0.33)
    stout = 1 + p.upper_pole * t
    a, b = 0.5 * p.width * stout, 0.5 * p.thickness * (0.5 + 0.5 * stout)
    value = (across / a) ** 2 + (v / b) ** 2 + power * np.abs(t)
    du, dv = 2 * across / a**2, 2 * v / b**2
    dw = (_POLE_POWER * power * np.sign(t) + 2 * du * p.bend * t) * (2 / p.length)
    slope = np.sqrt(du**2 + dv**2 + dw**2)
    # First-order distance: exact at the surface, where it is used.
    bean = (value - 1) / np.maximum(slope, 0.02)
    return _smooth_maximum(bean, -_sinus(p, u, v, w), _LIP)


def _sinus(p: KidneyParameters, u, v, w) -> np.ndarray:
    """About the signed distance (mm, negative inside) from the sinus, an ellipsoid across the hilum."""
    border = -0.5 * p.width + 0.33 * p.bend
    q = [(u - border) / p.sinus_depth, v / (0.5 * p.sinus_width), (w + 2.0) / (0.5 * p.sinus_length)]
    semi_axes = (p.sinus_depth, 0.5 * p.sinus_width, 0.5 * p.sinus_length)
    norm = np.sqrt(sum(part**2 for part in q))
    slope = np.sqrt(sum((part / s) ** 2 for part, s in zip(q, semi_axes, strict=True)))
    return norm * (norm - 1) / np.maximum(slope, 1e-6)


def _calyces(p: KidneyParameters) -> list[tuple[np.ndarray, np.ndarray]]:
    """Centre lines, (n, 3) mm in the kidney's own axes, and radii of the calyces that leave the sinus."""
    floor = -0.5 * p.width + 0.33 * p.bend + 0.75 * p.sinus_depth
    root, tip = 0.3 * p.sinus_width, 0.2 * p.sinus_width
    out = []
    for sign, forward in ((1.0, 1.0), (0.0, -2.0), (-1.0, 0.0)):
        start = (floor - 0.3 * p.sinus_depth, 0.0, 0.3 * sign * p.sinus_length)
        end = (floor + 0.1 * p.width * (1 - abs(sign)), forward, 0.3 * sign * p.length)
        out.append((np.array([start, end]), np.array([root, tip])))
    return out


def _smooth_maximum(a, b, width: float):
    """The larger of two fields, rounded where they differ by less than `width`; never below either."""
    close = np.maximum(width - np.abs(a - b), 0) / width
    return np.maximum(a, b) + close**2 * (0.25 * width)


def _tumour_centre(p: KidneyParameters) -> np.ndarray:
    """(3,) mm (lateral, posterior, superior): `tumour_depth` below the capsule, along its normal."""
    angle = np.deg2rad(p.tumour_angle_deg)
    w = 0.5 * p.length * p.tumour_height
    middle = np.array([-p.bend * (p.tumour_height**2 - 0.33), 0.0, w])
    outward = np.array([np.cos(angle), np.sin(angle), 0.0])
    # Outside, the last crossing of the capsule counts: towards the hilum the sinus makes more of them.
    steps = np.linspace(80.0, 0.0, 801)
    inside = _body(p, *(middle[:, None] + outward[:, None] * steps)) < 0
    last = int(np.argmax(inside))
    capsule = brentq(lambda s: _body(p, *(middle + s * outward)), steps[last], steps[last - 1])
    point = middle + capsule * outward
    tiny = 1e-3
    normal = np.array([_body(p, *(point + e)) - _body(p, *(point - e)) for e in tiny * np.eye(3)])
    local = point - p.tumour_depth * normal / np.linalg.norm(normal)
    return local @ _axes(p)
