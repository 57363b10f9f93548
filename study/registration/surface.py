"""Registration of a swabbed patch to a surface by iterative closest points, as an error that can be drawn.

A registration maps the patient, where the swab was traced, into the image. In a simulation the patch lies on
the surface and the true registration is the identity, so what ICP finds is its error: the start it was given,
and all that it did to it since. `SurfaceRegistration.sample` returns the inverse, where an image point lands
on the patient, which is what every error source returns.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from numbers import Integral, Real

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from study.errors import GeometryError, InputError
from study.registration.icp import IcpSettings, SurfaceFits, SurfaceTree, register_surface
from study.registration.moments import DisplacementMoments, sampled_moments
from study.registration.rigid import checked_fiducials, checked_points
from study.registration.sources import checked_std

#: What is taken as the patch's true place on the surface.
TRUTHS = ("projected", "fitted", "given")
#: Registrations from which the covariance of the error is estimated, and their seed: no other draw uses it.
_MOMENT_REGISTRATIONS = 2000
_MOMENT_SEED = 4_2_4
#: Registrations at once: bounds memory.
_CHUNK = 500
#: Root mean square distance of an aligned swab from its surface, over the surface's extent, at most.
_FAR = 0.05
#: Points and vertices from which a draw at random leaves enough for a fit.
_LEAST_RESAMPLED, _LEAST_KEPT = 10, 30


@dataclass(frozen=True, eq=False)
class SurfaceRegistration:
    """A surface registration under uncertain starts, digitiser noise and resampling, which can be drawn.

    Every draw perturbs the patch's true pose (position normal in x, y and z; a tilt about a random axis in
    the patch's plane, normal), gives every point a digitiser error, picks points and vertices at random, and
    runs ICP to its end (Siebold, 4.2.2 and 4.3.1, where only the start is perturbed and ICP is stopped early;
    see `published`).

    Parameters
    ----------
    surface : (v, 3) array or mesh
        Vertices of the segmented surface, mm, image axes; or a mesh with ``vertices`` and
        ``nearest.on_surface`` (trimesh).
    swab : (p, 3) array
        Points traced on the patient, aligned with the image (`align_surface` finds how); mm.
    position_std : float
        Of the start's position, along each axis, mm.
    tilt_std_deg : float
        Of the start's tilt, degrees.
    settings : IcpSettings
        When ICP stops.
    vertex_share : float
        Probability with which a vertex takes part in a registration. The text downsamples at random and
        does not say by how much.
    digitiser_std : float
        Error of every point of every draw along each axis, mm.
    resample_patch : bool
        Draw the patch's points with replacement: another tracing of the same patch.
    truth : {"projected", "fitted", "given"}, optional
        The patch's true place: every point moved to the nearest place on the surface, so that the given
        swab's own digitiser error is not counted twice (needs a mesh); the swab where converged ICP puts it
        from the given pose; or exactly as given. By default "projected" for a mesh, else "fitted".

    Raises
    ------
    InputError
        If a shape, range or choice is wrong, or the swab's points lie on one line.
    GeometryError
        If the swab is not aligned with the surface, or in another unit.

    Examples
    --------
    >>> surface = np.random.default_rng(0).normal(size=(500, 3)) * [30, 20, 15]
    >>> model = SurfaceRegistration(surface, surface[:60], truth="given")
    >>> model.sample(4, rng=0).shape
    (4, 4, 4)
    """

    surface: ArrayLike
    swab: ArrayLike
    position_std: float = 5.0
    tilt_std_deg: float = 5.0
    settings: IcpSettings = field(default_factory=IcpSettings)
    vertex_share: float = 0.5
    digitiser_std: float = 0.3
    resample_patch: bool = True
    truth: str | None = None

    def __post_init__(self) -> None:
        mesh = hasattr(self.surface, "nearest")
        set_ = object.__setattr__
        set_(self, "vertices", checked_points("surface", getattr(self.surface, "vertices", self.surface), 4))
        set_(self, "swab", checked_fiducials("swab", self.swab))
        for name in ("position_std", "tilt_std_deg", "digitiser_std"):
            set_(
                self,
                name,
                float(checked_std(name, getattr(self, name), "degrees" if "deg" in name else "mm")),
            )
        if not isinstance(self.vertex_share, Real) or not 0 < self.vertex_share <= 1:
            raise InputError(f"vertex_share: expected a number in (0, 1], got {self.vertex_share!r}")
        if not isinstance(self.settings, IcpSettings):
            raise InputError(f"settings: expected IcpSettings, got {type(self.settings).__name__}")
        truth = self.truth or ("projected" if mesh else "fitted")
        if truth not in TRUTHS or (truth == "projected" and not mesh):
            raise InputError(
                f"truth: expected one of {TRUTHS} ('projected' for a mesh alone), got {truth!r} for "
                f"{type(self.surface).__name__}"
            )
        set_(self, "truth", truth)
        if self.resample_patch and len(self.swab) < _LEAST_RESAMPLED:
            raise InputError(
                f"swab: expected at least {_LEAST_RESAMPLED} points to draw from with replacement "
                f"(resample_patch), got {len(self.swab)}"
            )
        if self.vertex_share < 1 and self.vertex_share * len(self.vertices) < _LEAST_KEPT:
            raise InputError(
                f"vertex_share: expected a share that leaves {_LEAST_KEPT} vertices or more, got "
                f"{self.vertex_share} of {len(self.vertices)}"
            )
        _checked_aligned(self.vertices, self.swab)
        set_(self, "tree", SurfaceTree.of(self.vertices))

    @classmethod
    def published(
        cls, surface: ArrayLike, swab: ArrayLike, position_std: float = 5.0, tilt_std_deg: float = 5.0
    ) -> SurfaceRegistration:
        """The printed simulation: ICP stopped early, a perfect digitiser, vertices downsampled at random.

        The registered swab is the truth there (4.3.1). How far registrations scatter says then how early ICP
        was stopped, not how well the patch fixes the pose.
        """
        return cls(
            surface,
            swab,
            position_std,
            tilt_std_deg,
            settings=IcpSettings.published(),
            digitiser_std=0.0,
            resample_patch=False,
            truth="fitted",
        )

    @cached_property
    def patch(self) -> np.ndarray:
        """(p, 3) the patch's true points, mm."""
        if self.truth == "given":
            return self.swab
        if self.truth == "projected":
            return np.asarray(self.surface.nearest.on_surface(self.swab)[0], dtype=float)
        fit = register_surface(self.tree, self.swab, np.eye(4)[None], IcpSettings())
        turn, shift = fit.transforms[0, :3, :3], fit.transforms[0, :3, 3]
        return self.swab @ turn.T + shift

    def starts(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) perturbations of the patch's true pose, mm."""
        rng = np.random.default_rng(rng)
        draws = rng.standard_normal((n, 6))
        centre = self.patch.mean(axis=0)
        plane = np.linalg.svd(self.patch - centre, full_matrices=False)[2][:2]
        # Two numbers for the direction of the axis, a third for the angle.
        about = draws[:, 3:5] / np.linalg.norm(draws[:, 3:5], axis=1, keepdims=True) @ plane
        angle = np.deg2rad(self.tilt_std_deg) * draws[:, 5]
        out = np.tile(np.eye(4), (n, 1, 1))
        out[:, :3, :3] = Rotation.from_rotvec(about * angle[:, None]).as_matrix()
        out[:, :3, 3] = centre - out[:, :3, :3] @ centre + self.position_std * draws[:, :3]
        return out

    def register(self, n: int, rng: object = None) -> SurfaceFits:
        """Simulate registrations.

        The first of many are those that fewer would have been, from the same seed.

        Parameters
        ----------
        n : int
        rng : anything `numpy.random.default_rng` takes

        Returns
        -------
        SurfaceFits
            ``transforms``: where ICP puts the patch's true points, mm.

        Raises
        ------
        InputError
            If `n` is not a positive integer.
        """
        if not isinstance(n, Integral) or isinstance(n, bool) or n < 1:
            raise InputError(f"n: expected a positive whole number of registrations, got {n!r}")
        rng = np.random.default_rng(rng)
        # A stream for each cause: what one of them takes does not change the others.
        starting, picking, tracing, digitising = (
            np.random.default_rng(seed) for seed in rng.integers(2**63, size=4)
        )
        parts = []
        for begin in range(0, int(n), _CHUNK):
            count = min(_CHUNK, int(n) - begin)
            starts = self.starts(count, starting)
            kept = None
            if self.vertex_share < 1:
                kept = picking.random((count, len(self.vertices)), dtype=np.float32) < self.vertex_share
            swab = self.patch
            if self.resample_patch:
                swab = swab[tracing.integers(len(swab), size=(count, len(swab)))]
            if self.digitiser_std > 0:
                swab = swab + self.digitiser_std * digitising.standard_normal((count, *self.patch.shape))
            parts.append(register_surface(self.tree, swab, starts, self.settings, kept))
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in ("transforms", "converged", "iterations", "rms")
        }
        return SurfaceFits(**joined, settings=self.settings)

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """Draw registrations, converged or not.

        Parameters
        ----------
        n : int
        rng : anything `numpy.random.default_rng` takes

        Returns
        -------
        (n, 4, 4) array
            Where an image point lands instead of itself, mm, image axes.
        """
        return np.linalg.inv(self.register(n, rng).transforms)

    @cached_property
    def _drawn(self) -> np.ndarray:
        return self.sample(_MOMENT_REGISTRATIONS, _MOMENT_SEED)

    def moments(self) -> DisplacementMoments:
        """Covariance of the displacement of any point, about its mean, from 2000 registrations of its own."""
        return sampled_moments(self._drawn)

    def bias(self, points: ArrayLike) -> np.ndarray:
        """(m, 3) mean displacement of (m, 3) points, mm; from the same registrations."""
        points = checked_points("points", points)
        mean = self._drawn.mean(axis=0)
        return points @ mean[:3, :3].T + mean[:3, 3] - points

    def tre_covariance(self, points: ArrayLike) -> np.ndarray:
        """(m, 3, 3) covariance of the target registration error at (m, 3) points about its mean, mm^2."""
        return self.moments().at(points)

    def digitised(self, n: int, rng: object = None) -> list[SurfaceRegistration]:
        """Models of this patch as traced n times: each keeps the digitiser errors of one tracing.

        The union of the margins that these need is what the text proposes against digitiser error (5.2).

        Parameters
        ----------
        n : int
        rng : anything `numpy.random.default_rng` takes
        """
        rng = np.random.default_rng(rng)
        errors = self.digitiser_std * rng.standard_normal((n, *self.patch.shape))
        return [
            replace(self, swab=self.patch + error, digitiser_std=0.0, resample_patch=False, truth="given")
            for error in errors
        ]


def _checked_aligned(vertices: np.ndarray, swab: np.ndarray) -> None:
    extent = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    distance = float(np.sqrt((cKDTree(vertices).query(swab)[0] ** 2).mean()))
    spacing = float(
        np.median(cKDTree(vertices).query(vertices[:: max(1, len(vertices) // 500)], k=2)[0][:, 1])
    )
    if distance > _FAR * extent + spacing:
        raise GeometryError(
            f"swab: expected points on the surface, mm; they are {distance:.3g} mm from its vertices (root "
            f"mean square) and extend over {np.ptp(swab, axis=0).round(3).tolist()} mm, the surface over "
            f"{np.ptp(vertices, axis=0).round(3).tolist()} mm. Is the unit mm? If the swab is in another "
            f"frame, align_surface(surface, swab) finds the way"
        )
