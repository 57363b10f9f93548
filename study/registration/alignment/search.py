"""A swab is aligned with a surface when nobody knows where on it, or which way round, it was traced."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.registration.alignment.hypotheses import apart, different, poses, sites
from study.registration.alignment.planes import TangentPlanes, fit_planes
from study.registration.alignment.settings import AlignmentSettings
from study.registration.icp.fits import checked_starts, checked_swabs
from study.registration.rigid import checked_points
from study.threads import in_threads

#: Steps and the share of the poses that goes on, round by round. On kidneys poses near the truth lead after
#: the first round already and are some tens after the last.
ROUNDS = ((3, 0.2), (3, 0.25), (6, 1.0))
#: Of the last fits, with the whole swab and the nearest vertices: hardly damped, so that they slide freely.
FINAL_STEPS, FINAL_DAMPING = 20, 1e-3
#: Below which the last step counts as none, root mean square over the swab, mm. Matches that change to and
#: fro between vertices keep fits on kidneys moving by some 0.01 mm.
CONVERGED = 0.05
#: Poses that are fitted at once, so that their arrays stay in the processor's memory.
BATCH = 128


@dataclass(frozen=True, eq=False)
class Alignment:
    """How a swab lies on a surface, and how far the next best answer is from doing so as well.

    Attributes
    ----------
    transform : (4, 4) array
        From the swab to the surface, mm.
    rms : float
        Root mean square distance of the swab from the tangent planes of the nearest vertices, mm.
    second_rms : float
        The same for the best of the clearly different poses; infinite if there is none.
    second_transform : (4, 4) array
        That pose.
    second_apart : float
        Root mean square distance between the swab in the two poses, mm.
    hypotheses : int
        Poses that were tried.
    converged : bool
        Whether the last step of the best pose's fit was below 0.05 mm.
    settings : AlignmentSettings
    """

    transform: np.ndarray
    rms: float
    second_rms: float
    second_transform: np.ndarray
    second_apart: float
    hypotheses: int
    converged: bool
    settings: AlignmentSettings

    @property
    def ratio(self) -> float:
        """`second_rms` over `rms`: near 1, the surface does not tell which of the two poses is true."""
        return self.second_rms / self.rms if self.rms else np.inf


def align_surface(
    surface: ArrayLike,
    swab: ArrayLike,
    rng: object = 0,
    *,
    around: ArrayLike | None = None,
    within: float = 30.0,
    settings: AlignmentSettings | None = None,
) -> Alignment:
    """Find the rigid transform that lays a swab on a surface, from no start.

    The text had GoICP do this (Section 4.2.2). Here the swab is tried with its mean at sites all over the
    surface, lying on it with either side up and turned about the normal in steps. All poses are fitted to
    the tangent planes of nearby vertices with a few points and steps, the better part goes on with more of
    both, and the last ones are fitted with the whole swab to the nearest vertices. The smallest distance
    wins. This is dense sampling, not a proof: see `Alignment.ratio` for how clear the answer is.

    Parameters
    ----------
    surface : (v, 3) array or mesh
        Vertices, mm; or a mesh with ``vertices`` and ``vertex_normals`` (trimesh). Without normals they are
        estimated from neighbouring vertices.
    swab : (p, 3) array
        Points on the surface, mm, in a frame of their own.
    rng : int, Generator or None
        Draws the points of the early rounds and the first site.
    around : (4, 4) array, optional
        A transform to search near.
    within : float
        How far from there poses are tried, root mean square over the swab, mm.
    settings : AlignmentSettings, optional

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        If a shape is wrong, a value not finite, the swab on one line, or `around` not rigid.
    GeometryError
        If the swab is so small or large beside the surface that one of them cannot be in mm.
    """
    settings = AlignmentSettings() if settings is None else settings
    if not isinstance(settings, AlignmentSettings):
        raise InputError(f"settings: expected AlignmentSettings, got {type(settings).__name__}")
    points = checked_points("surface", getattr(surface, "vertices", surface), least=4)
    swab = checked_swabs(_one_swab(swab), 1, float(np.linalg.norm(np.ptp(points, axis=0))))[0]
    rng = np.random.default_rng(rng)
    mean = swab.mean(axis=0)
    centred = swab - mean
    size = float(np.sqrt((centred**2).sum(axis=1).mean()))
    planes = TangentPlanes.of(points, _normals(surface, len(points)), size)
    turns, places = poses(
        centred,
        *sites(planes, settings.site_spacing * size, size, int(rng.integers(len(points)))),
        settings.angle_step_deg,
    )
    if around is not None:
        turns, places = _near(centred, mean, turns, places, checked_starts([around])[0], within)
    tried = len(turns)

    order = rng.permutation(len(centred))
    most = settings.coarse_points
    for steps, share in ROUNDS:
        turns, places, rms, _ = _fit(planes, centred[order[:most]], turns, places, steps)
        going_on = max(settings.finalists, int(np.ceil(share * len(turns))))
        best = np.argsort(rms, kind="stable")[:going_on]
        turns, places, rms = turns[best], places[best], rms[best]
        most *= 2
    least = settings.distinct * size
    best = different(centred, turns, places, rms, least / 2, settings.finalists)
    turns, places = turns[best], places[best]
    turns, places, rms, last = _fit(planes, centred, turns, places, FINAL_STEPS, True, FINAL_DAMPING)
    best = different(centred, turns, places, rms, least, 2)
    transforms = [_transform(turns[k], places[k], mean) for k in best]
    second = best[1] if len(best) > 1 else None
    gap = np.inf
    if second is not None:
        gap = apart(centred, turns[[second]], places[[second]], turns[best[0]], places[best[0]])[0]
    return Alignment(
        transform=transforms[0],
        rms=float(rms[best[0]]),
        second_rms=np.inf if second is None else float(rms[second]),
        second_transform=transforms[-1],
        second_apart=float(gap),
        hypotheses=tried,
        converged=bool(last[best[0]] < CONVERGED),
        settings=settings,
    )


def _one_swab(swab: ArrayLike) -> np.ndarray:
    swab = np.array(swab, dtype=float)
    if swab.ndim != 2:
        raise InputError(f"swab: expected points of shape (p, 3) in mm, got shape {swab.shape}")
    return swab


def _normals(surface: ArrayLike, count: int) -> np.ndarray | None:
    """Unit normals of a mesh, None where there are none to rely on."""
    normals = getattr(surface, "vertex_normals", None)
    if normals is None or np.shape(normals) != (count, 3):
        return None
    normals = np.array(normals, dtype=float)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.isfinite(length).all() or (length < 0.5).any():  # vertices without a face
        return None
    return normals / length


def _near(
    swab: np.ndarray,
    mean: np.ndarray,
    turns: np.ndarray,
    places: np.ndarray,
    around: np.ndarray,
    within: float,
) -> tuple[np.ndarray, np.ndarray]:
    """The poses near a known one, and that one itself."""
    if not (np.isscalar(within) and np.isreal(within) and 0 < within < np.inf):
        raise InputError(f"within: expected a positive number of mm, got {within!r}")
    turn, place = around[:3, :3], around[:3, :3] @ mean + around[:3, 3]
    kept = apart(swab, turns, places, turn, place) <= within
    return np.concatenate([turns[kept], turn[None]]), np.concatenate([places[kept], place[None]])


def _fit(
    planes: TangentPlanes, swab: np.ndarray, turns: np.ndarray, places: np.ndarray, steps: int, *how: object
) -> tuple[np.ndarray, ...]:
    """`fit_planes` in batches, on as many threads as there are."""
    batch = max(1, min(BATCH, BATCH * 40 // len(swab)))
    out = np.empty_like(turns), np.empty_like(places), np.empty(len(turns)), np.empty(len(turns))

    def part(piece: slice) -> None:
        for start in range(piece.start, piece.stop, batch):
            some = slice(start, min(start + batch, piece.stop))
            fitted = fit_planes(planes, swab, turns[some], places[some], steps, *how)
            for whole, own in zip(out, fitted, strict=True):
                whole[some] = own

    in_threads(part, len(turns), least=2)
    return out


def _transform(turn: np.ndarray, place: np.ndarray, mean: np.ndarray) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = turn
    transform[:3, 3] = place - turn @ mean
    return transform
