"""Registrations of a kidney drawn once for all margins that are grown on them, and how they scatter."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.registration import (
    DisplacementMoments,
    SurfaceFits,
    SurfaceRegistration,
    sampled_moments,
)


class RememberedRegistrations:
    """A surface registration whose draws are kept: the same draw from the same generator is made once.

    Margins of both shapes and by both methods are grown with one seed, hence on the same registrations, and
    an iterative closest point fit costs more than growing on it. What comes out is what the model itself
    would have given, and the generator is left as the model would have left it.

    Parameters
    ----------
    model : SurfaceRegistration

    Attributes
    ----------
    seconds : float
        Spent in the model.
    """

    def __init__(self, model: SurfaceRegistration) -> None:
        self.model = model
        self.seconds = 0.0
        self._fits: dict[tuple, tuple[SurfaceFits, dict, int]] = {}
        self._moments: DisplacementMoments | None = None

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms, see `study.registration.ErrorSource`."""
        rng = np.random.default_rng(rng)
        bits, seeds = rng.bit_generator, rng.bit_generator.seed_seq
        # children drawn from a generator's seed do not show in its state
        key = (n, repr(bits.state), repr(seeds))
        if key not in self._fits:
            begun = time.perf_counter()
            fits = self.model.register(n, rng)
            self.seconds += time.perf_counter() - begun
            self._fits[key] = fits, bits.state, seeds.n_children_spawned
        fits, after, children = self._fits[key]
        bits.state = after
        seeds.spawn(children - seeds.n_children_spawned)
        return np.linalg.inv(fits.transforms)

    def moments(self) -> DisplacementMoments:
        """Covariance of the displacement about its mean, from the first registrations drawn.

        Where none is drawn yet, from the model's own. Margins to remove are grown without it: it serves to
        report distances.
        """
        if self._moments is None:
            begun = time.perf_counter()
            if self._fits:
                self._moments = sampled_moments(np.linalg.inv(self.fits[0].transforms))
            else:
                self._moments = self.model.moments()
            self.seconds += time.perf_counter() - begun
        return self._moments

    @property
    def fits(self) -> list[SurfaceFits]:
        """All registrations drawn so far, in the order of the draws."""
        return [fits for fits, _, _ in self._fits.values()]


@dataclass(frozen=True)
class Scatter:
    """How registrations move points.

    Attributes
    ----------
    scatter_mm : float
        Root mean square distance from where a point lands on average.
    bias_mm : float
        Root mean square distance, over the points, from a point to where it lands on average.
    """

    scatter_mm: float
    bias_mm: float

    @property
    def tre_mm(self) -> float:
        """Root mean square target registration error, mm: both together."""
        return float(np.hypot(self.scatter_mm, self.bias_mm))


def scatter_at(transforms: np.ndarray, points: ArrayLike) -> Scatter:
    """Scatter and bias of registrations over a set of points.

    Parameters
    ----------
    transforms : (n, 4, 4) array
        Where a point lands, mm.
    points : (m, 3) array_like
        Such as the tumour's voxels, mm.
    """
    points = np.asarray(points, dtype=float)
    centre = points.mean(axis=0)
    # about the points' centre, so that large coordinates cancel before squares are taken
    arms = np.column_stack([points - centre, np.ones(len(points))])
    motion = transforms[:, :3] - np.eye(4)[:3]
    motion[:, :, 3] += motion[:, :, :3] @ centre
    mean = motion.mean(axis=0)
    second = arms.T @ arms / len(points)
    deviation = motion - mean
    scatter = np.einsum("nai,ij,naj->", deviation, second, deviation, optimize=True) / len(transforms)
    return Scatter(float(np.sqrt(scatter)), float(np.sqrt(np.einsum("ai,ij,aj->", mean, second, mean))))
