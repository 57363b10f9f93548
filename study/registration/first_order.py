"""First-order covariance of the target registration error (Danilchenko and Fitzpatrick).

Two statements of the same theory: the general one for any localisation error and any weights, and the
closed form for errors that are alike in all directions and at all fiducials, whose trace is the formula
of Fitzpatrick and West.
"""

from __future__ import annotations

import numpy as np


def cross_matrices(vectors: np.ndarray) -> np.ndarray:
    """(n, 3, 3) matrices with ``cross_matrices(a)[i] @ b == cross(a[i], b)``."""
    x, y, z = np.moveaxis(np.asarray(vectors, dtype=float), -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2
    )


def motion_of_points(points: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(m, 3, 6) Jacobian of points by a small rotation vector about a centre and a translation."""
    points = np.asarray(points, dtype=float)
    jacobian = np.zeros((len(points), 3, 6))
    jacobian[:, :, :3] = -cross_matrices(points - centre)
    jacobian[:, :, 3:] = np.eye(3)
    return jacobian


def motion_covariance(
    fiducials: np.ndarray,
    covariances: np.ndarray,
    centre: np.ndarray,
    weights: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of the rigid motion by which a registration misses the truth, to first order.

    Parameters
    ----------
    fiducials : (n, 3) array
        True positions in the space that is registered to, mm.
    covariances : (n, 3, 3) array
        Of the localisation error there: ``S_phys + R S_img R^T``, mm^2.
    centre : (3,) array
        About which the rotation is meant, mm.
    weights : (n,) or (n, 3, 3) array, optional
        ``V_i = W_i^T W_i`` of the squared residuals that the registration minimises; numbers stand for
        multiples of the unit matrix. All alike by default.

    Returns
    -------
    (6, 6) array
        Rotation vector (rad) first, then translation (mm): ``C = H^-1 B H^-1``.
    """
    jacobian = motion_of_points(fiducials, centre)
    weights = np.ones(len(fiducials)) if weights is None else np.asarray(weights, dtype=float)
    if weights.ndim == 1:
        weights = weights[:, None, None] * np.eye(3)
    weighted = weights @ jacobian
    h = np.einsum("nij,nik->jk", jacobian, weighted)
    b = np.einsum("nij,nik,nkl->jl", weighted, covariances, weighted)
    left = np.linalg.solve(h, b)
    return np.linalg.solve(h, left.T).T


def first_order_tre_covariance(
    points: np.ndarray,
    fiducials: np.ndarray,
    covariances: np.ndarray,
    weights: np.ndarray | None = None,
) -> np.ndarray:
    """(m, 3, 3) covariance of the target registration error at points, mm^2, for any localisation error.

    Parameters
    ----------
    points : (m, 3) array
        In the space that is registered to, mm.
    fiducials, covariances, weights
        See `motion_covariance`.
    """
    centre = np.mean(fiducials, axis=0)
    jacobian = motion_of_points(points, centre)
    return jacobian @ motion_covariance(fiducials, covariances, centre, weights) @ np.swapaxes(jacobian, 1, 2)


def isotropic_tre_covariance(points: np.ndarray, fiducials: np.ndarray, variance: float) -> np.ndarray:
    """The same where localisation errs alike in all directions and at all fiducials.

    ``variance (I / N + [p - c]x J^-1 [p - c]x^T)`` with the fiducials' inertia J about their centroid c.

    Parameters
    ----------
    points : (m, 3) array
        mm.
    fiducials : (n, 3) array
        mm.
    variance : float
        Of one component, both spaces together, mm^2.

    Returns
    -------
    (m, 3, 3) array
        mm^2.
    """
    centre = np.mean(fiducials, axis=0)
    arms = cross_matrices(fiducials - centre)
    inertia = np.einsum("nij,nkj->ik", arms, arms)
    cross = cross_matrices(np.asarray(points, dtype=float) - centre)
    lever = cross @ np.linalg.solve(inertia, np.swapaxes(cross, 1, 2))
    return variance * (np.eye(3) / len(fiducials) + lever)
