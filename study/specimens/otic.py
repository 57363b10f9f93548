"""Where the small structures of the ear lie: centre lines in mm from the dome of the lateral canal.

Axes are (lateral, posterior, superior). The shapes are schematic, their places and sizes those of an
adult ear: three canals of about 6 mm across at right angles to each other, a cochlea of two and a half
turns with its axis along the inner canal's front, a facial nerve with two genua.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.specimens.parameters import TemporalBoneParameters
from study.specimens.shapes import Grid, carve_ellipsoid, carve_tube, swept

_UP = np.array([0.0, 0.0, 1.0])
#: Along the petrous ridge (backwards and outwards) and across it (forwards and outwards).
_ALONG_RIDGE = np.array([0.72, 0.69, 0.0])
_ACROSS_RIDGE = np.array([0.69, -0.72, 0.0])
#: The lateral canal rises by 25 degrees towards the front.
_LATERAL_FORWARD = np.array([0.0, -np.cos(np.deg2rad(25)), np.sin(np.deg2rad(25))])
_CANAL_TUBE = 0.72

_VESTIBULE = ((-5.4, -1.9, -1.2), (1.6, 2.4, 2.1))


def _arc(centre, u, v, radius: float, start_deg: float, end_deg: float, samples: int = 18) -> np.ndarray:
    angle = np.deg2rad(np.linspace(start_deg, end_deg, samples))[:, None]
    return np.asarray(centre) + radius * (np.cos(angle) * u + np.sin(angle) * v)


def _cochlea(samples: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Centre line and radii of two and a half turns, from the round window to the apex."""
    modiolus = np.array([0.55, -0.80, -0.22])
    modiolus /= np.linalg.norm(modiolus)
    u = np.cross(modiolus, _UP)
    u /= np.linalg.norm(u)
    v = np.cross(modiolus, u)
    turn = np.linspace(0, 2.5 * 2 * np.pi, samples)
    part = turn / turn[-1]
    radius = 3.1 * (1 - part) ** 0.8 + 0.7
    spiral = radius[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    points = np.array([-10.2, -5.6, -2.9]) + spiral + (part * 3.4)[:, None] * modiolus
    return points, 1.0 - 0.4 * part


def carve_labyrinth(field: np.ndarray, grid: Grid, scale: float, reach: float) -> None:
    """Lower `field` to the signed distance (mm) from vestibule, canals and cochlea."""
    centre, semi_axes = (scale * np.asarray(part) for part in _VESTIBULE)
    carve_ellipsoid(field, grid, centre, semi_axes, reach)
    canals = [
        # The dome at the origin is the outer face of the lateral canal's tube.
        _arc((-3.3, -0.2, -0.1), np.array([1.0, 0, 0]), _LATERAL_FORWARD, 2.58, -140, 140),
        _arc((-4.6, -2.4, 2.6), _ACROSS_RIDGE, _UP, 3.1, -50, 230),
        _arc((-5.0, 2.4, 0.4), _ALONG_RIDGE, _UP, 3.0, -150, 130),
    ]
    for points in canals:
        carve_tube(field, grid, scale * points, scale * _CANAL_TUBE, reach)
    # The common crus joins the upper and the posterior canal above the vestibule.
    crus = scale * np.array([canals[1][-1], (-6.6, -0.2, 1.4), canals[2][-1]])
    carve_tube(field, grid, swept(crus, 8), scale * _CANAL_TUBE, reach)
    points, radii = _cochlea()
    carve_tube(field, grid, scale * points, scale * radii, reach)


def inner_canal(scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Centre line and radii of the internal auditory canal, from its fundus to the porus."""
    points = scale * np.array(
        [(-8.6, -3.8, 0.0), (-11.0, -3.3, -0.2), (-15.5, -2.8, -0.3), (-22.5, -2.2, -0.4)]
    )
    return points, scale * np.array([1.7, 2.2, 2.5, 3.4])


def ossicles(scale: float) -> dict[str, list[tuple[np.ndarray, float]]]:
    """Tubes (points, radius) of each ossicle; the incus' short process points at the antrum."""
    parts = {
        "malleus": [
            ([(-0.9, -6.6, 0.2), (-1.2, -6.6, -0.9)], 1.1),
            ([(-1.2, -6.6, -1.0), (-3.4, -5.9, -5.3)], 0.55),
        ],
        "incus": [
            ([(-0.5, -5.4, -0.2), (-0.3, -4.8, -0.8)], 1.1),
            ([(-0.2, -4.6, -0.6), (1.0, -2.4, -0.4)], 0.7),
            ([(-0.7, -4.8, -1.0), (-3.0, -4.4, -3.9)], 0.5),
        ],
        "stapes": [([(-3.5, -4.2, -3.7), (-5.0, -3.0, -2.9)], 0.5)],
    }
    return {name: [(scale * np.array(p), scale * r) for p, r in tubes] for name, tubes in parts.items()}


@dataclass(frozen=True, eq=False)
class CentreLines:
    """Centre lines of one bone's nerve, chorda, ear canal, sinus and carotid, (n, 3) mm each."""

    facial_nerve: np.ndarray
    chorda_tympani: np.ndarray
    external_auditory_canal: np.ndarray
    canal_radii: np.ndarray
    sigmoid_sinus: np.ndarray
    sinus_radii: np.ndarray
    carotid_artery: np.ndarray


def centre_lines(p: TemporalBoneParameters, depth: float) -> CentreLines:
    """Centre lines for some parameters; `depth` (mm) is how far laterally the ear canal has to reach."""
    o = p.otic_scale
    # The mastoid segment keeps its distance behind the ear canal; further back it also runs backwards.
    behind, backwards = 7.8 - p.canal_lead, 0.09 * (7.5 - p.canal_lead)
    genu = np.array([-1.6, min(1.4, behind - 1.0), -3.1])
    start = np.array([-1.3, behind - 0.3 * backwards, -5.3])
    down = np.array([p.nerve_slant, backwards, -1.0])
    foramen = start + (p.nerve_length - 2.2) * down / np.linalg.norm(down)
    nerve = swept(
        [
            *(o * np.array([(-9.6, -4.6, 0.6), (-8.3, -7.6, 0.9), (-5.4, -5.2, -0.3), (-3.3, -2.2, -1.7)])),
            genu,
            start,
            0.5 * (start + foramen),
            foramen,
        ],
        40,
    )
    branch = start + 0.6 * (foramen - start)
    chorda = swept(
        [
            branch,
            branch + np.array([0.7, -0.9, 1.4]),
            (start[0] + 1.3 + 2 * p.nerve_slant, behind - 1.7, 0.5 * (branch[2] - 5.5)),
            (start[0] + 1.2, behind - 3.9, -p.canal_drop + 2.4),
            (-0.6, behind - 6.6, -p.canal_drop + 3.2),
        ],
        24,
    )
    lateral = np.array([-2.4, 0.8, 4.5, 9.0, 14.0, max(20.0, depth)])
    canal = np.column_stack(
        [
            lateral,
            -p.canal_lead + np.array([-1.6, -0.9, 0.0, 0.8, 1.3, 1.5]),
            -p.canal_drop + np.array([-1.6, -0.1, 0.2, -0.7, -2.2, -3.0]),
        ]
    )
    radii = p.canal_radius * np.array([0.72, 0.82, 0.95, 1.05, 1.3, 1.5])
    r, front = p.sinus_radius, p.sinus_distance * p.size
    middle = 0.5 * depth
    # The drawn distance is that of the front wall of the vertical part.
    sinus = np.array(
        [
            (middle + 2.0, front + r + 16.0, 9.0),
            (middle + 1.0, front + r + 6.0, 6.0),
            (middle, front + r, -1.0),
            (0.35 * depth, front + 0.9 * r, -9.0),
            (-1.0, 0.55 * front + r + 1.5, -14.5),
            (-9.0, 6.5, -13.5),
        ]
    )
    carotid = o * np.array(
        [
            (-14.0, -3.5, -24.0),
            (-13.5, -4.5, -14.0),
            (-14.5, -6.5, -10.0),
            (-18.0, -9.5, -8.5),
            (-27.0, -16.0, -8.0),
        ]
    )
    return CentreLines(
        nerve,
        chorda,
        swept(canal, 30),
        np.interp(np.linspace(0, 1, 30), np.linspace(0, 1, 6), radii),
        swept(sinus, 28),
        np.interp(np.linspace(0, 1, 28), [0, 0.5, 1], [r, r, 0.85 * r]),
        swept(carotid, 20),
    )
