"""Second moments of a displacement that is affine in the point, as every error transform's is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.registration.first_order import cross_matrices
from study.registration.rigid import checked_points


@dataclass(frozen=True, eq=False)
class DisplacementMoments:
    """Covariance of ``u(p) = G (p - centre) + u(centre)``.

    Attributes
    ----------
    centre : (3,) array
        mm.
    covariance : (12, 12) array
        Of the rows of the (3, 4) matrix ``[G, u(centre)]``, one after the other.
    """

    centre: np.ndarray
    covariance: np.ndarray

    @classmethod
    def of_motion(cls, centre: np.ndarray, motion: np.ndarray) -> DisplacementMoments:
        """From the (6, 6) covariance of a small rotation vector (rad) and a translation (mm)."""
        build = np.zeros((3, 4, 6))
        build[:, :3, :3] = np.moveaxis(cross_matrices(np.eye(3)), 0, -1)
        build[:, 3, 3:] = np.eye(3)
        build = build.reshape(12, 6)
        return cls(np.asarray(centre, dtype=float), build @ motion @ build.T)

    def about(self, centre: np.ndarray) -> DisplacementMoments:
        """The same about another centre, mm."""
        move = np.eye(4)
        move[:3, 3] = np.asarray(centre, dtype=float) - self.centre
        move = np.kron(np.eye(3), move.T)
        return DisplacementMoments(np.asarray(centre, dtype=float), move @ self.covariance @ move.T)

    def at(self, points: ArrayLike) -> np.ndarray:
        """(m, 3, 3) covariance of the displacement of (m, 3) points, mm^2."""
        points = checked_points("points", points)
        arm = np.column_stack([points - self.centre, np.ones(len(points))])
        return np.einsum("mj,ajbk,mk->mab", arm, self.covariance.reshape(3, 4, 3, 4), arm, optimize=True)


def sampled_moments(transforms: np.ndarray) -> DisplacementMoments:
    """Moments of drawn transforms, about their mean.

    Parameters
    ----------
    transforms : (n, 4, 4) array
        mm.
    """
    parameters = (transforms - np.eye(4))[:, :3].reshape(len(transforms), 12)
    return DisplacementMoments(np.zeros(3), np.cov(parameters, rowvar=False))
