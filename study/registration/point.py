"""Registration by fiducials whose places are known only up to a localisation error."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.registration import _kernels
from study.registration.first_order import motion_covariance
from study.registration.moments import DisplacementMoments
from study.registration.rigid import checked_fiducials, checked_weights, register_many

#: Root of the mean squared length of a localisation error, mm (Siebold, 3.3.1).
FLE_RMS = 0.176
# Registrations solved at once: bounds memory.
_CHUNK = 100_000


@dataclass(frozen=True, eq=False)
class PointRegistration:
    """A point registration under fiducial localisation error (FLE), which can be drawn.

    Fiducials are localised with normal errors in the image and on the patient, and the closed form of
    `register_points` fits one to the other. The model's frame is the image's: the true transform is
    the identity, and what is drawn is where an image point lands instead of itself.

    Parameters
    ----------
    fiducials : (n, 3) array
        True positions, mm, image axes; three or more, not on one line.
    fle_rms : float or (float, float)
        Root of the mean squared 3-D length of the error, mm, alike in all directions and at all fiducials;
        in each of both spaces, or (image, physical). The printed 0.176 mm holds in each
        (Siebold, 3.3.1).
    image_covariances, physical_covariances : (3, 3) or (n, 3, 3) array, optional
        mm^2; takes the place of `fle_rms` in its space, one for all or one a fiducial. Positive definite.
    weights : (n,) array, optional
        Of the squared distances that the registration minimises. All alike by default, as printed.
    R_physical_image : (3, 3) array, optional
        Rotation from image to physical axes, in which `physical_covariances` are given. The identity by
        default.

    Raises
    ------
    InputError
        If there are fewer than three fiducials or all lie on a line, a covariance is not symmetric and
        positive definite, an rms is negative or both are 0, a weight is not positive, or the rotation is not
        one.

    Examples
    --------
    >>> model = PointRegistration([[0, 0, 0], [40, 0, 0], [0, 40, 0]], fle_rms=0.176)
    >>> model.sample(5, rng=0).shape
    (5, 4, 4)
    """

    fiducials: ArrayLike
    fle_rms: float | tuple[float, float] = FLE_RMS
    image_covariances: ArrayLike | None = None
    physical_covariances: ArrayLike | None = None
    weights: ArrayLike | None = None
    R_physical_image: ArrayLike | None = None

    def __post_init__(self) -> None:
        fiducials = checked_fiducials("fiducials", self.fiducials)
        rms = self._checked_rms(self.fle_rms)
        turn = self._checked_rotation(self.R_physical_image)
        image = _checked_covariances("image_covariances", self.image_covariances, len(fiducials), rms[0])
        physical = _checked_covariances(
            "physical_covariances", self.physical_covariances, len(fiducials), rms[1]
        )
        if not (image.any() or physical.any()):
            raise InputError(
                f"fle_rms: expected an error above 0 mm in one space at least, got {self.fle_rms}"
            )
        values = {
            "fiducials": fiducials,
            "image_covariances": image,
            "physical_covariances": physical,
            "weights": checked_weights(self.weights, len(fiducials)),
            "R_physical_image": turn,
        }
        for name, value in values.items():
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @staticmethod
    def _checked_rms(rms: float | tuple[float, float]) -> np.ndarray:
        pair = np.array(rms, dtype=float)
        if pair.shape not in ((), (2,)) or not np.isfinite(pair).all() or (pair < 0).any():
            raise InputError(f"fle_rms: expected mm of at least 0, one or (image, physical), got {rms}")
        return np.broadcast_to(pair, (2,))

    @staticmethod
    def _checked_rotation(rotation: ArrayLike | None) -> np.ndarray:
        turn = np.eye(3) if rotation is None else np.array(rotation, dtype=float)
        if turn.shape != (3, 3) or not (
            np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
        ):
            raise InputError(f"R_physical_image: expected a (3, 3) rotation, got {turn.tolist()}")
        return turn

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """Draw registrations.

        The first of many are those that fewer would have been, from the same seed.

        Parameters
        ----------
        n : int
        rng : anything `numpy.random.default_rng` takes

        Returns
        -------
        (n, 4, 4) array
            Where an image point lands instead of itself, mm, image axes.

        Raises
        ------
        InputError
            If `n` is not a positive integer.
        """
        if not isinstance(n, Integral) or n < 1:
            raise InputError(f"n: expected a positive whole number of registrations, got {n!r}")
        rng = np.random.default_rng(rng)
        roots = [_root(self.image_covariances), _root(self._physical_in_image_axes())]
        out = np.empty((int(n), 4, 4))
        for start in range(0, len(out), _CHUNK):
            count = min(_CHUNK, len(out) - start)
            # One registration after the other, so that the chunks' length changes no number.
            white = rng.standard_normal((count, 2, len(self.fiducials), 3))
            image, physical = (
                _scattered(self.fiducials, root, np.ascontiguousarray(white[:, space]))
                for space, root in enumerate(roots)
            )
            out[start : start + count] = register_many(image, physical, self.weights)
        return out

    def moments(self) -> DisplacementMoments:
        """First-order covariance of the displacement of any point (Danilchenko and Fitzpatrick)."""
        centre = self.fiducials.mean(axis=0)
        both = self.image_covariances + self._physical_in_image_axes()
        return DisplacementMoments.of_motion(
            centre, motion_covariance(self.fiducials, both, centre, self.weights)
        )

    def _physical_in_image_axes(self) -> np.ndarray:
        """(n, 3, 3) mm^2: an error d on the patient is R^T d in the image."""
        turn = self.R_physical_image
        return turn.T @ self.physical_covariances @ turn

    def tre_covariance(self, points: ArrayLike) -> np.ndarray:
        """(m, 3, 3) first-order covariance of the target registration error at (m, 3) points, mm^2."""
        return self.moments().at(points)

    def tre_rms(self, points: ArrayLike) -> np.ndarray:
        """(m,) root mean squared target registration error at points, mm."""
        return np.sqrt(np.trace(self.tre_covariance(points), axis1=1, axis2=2))


def _scattered(points: np.ndarray, roots: np.ndarray, white: np.ndarray) -> np.ndarray:
    """(n, f, 3) copies of fiducials, each with an error of its own; uses up the white noise."""
    _kernels.scatter(points, roots, white, white)
    return white


def _root(covariances: np.ndarray) -> np.ndarray:
    """(n, 3, 3) lower triangular roots; zero where the covariance is."""
    return np.linalg.cholesky(covariances) if covariances.any() else np.zeros_like(covariances)


def _checked_covariances(name: str, given: ArrayLike | None, count: int, rms: float) -> np.ndarray:
    if given is None:
        return np.tile(np.eye(3) * rms**2 / 3, (count, 1, 1))
    given = np.array(given, dtype=float)
    if given.shape not in ((3, 3), (count, 3, 3)) or not np.isfinite(given).all():
        raise InputError(
            f"{name}: expected finite mm^2 of shape (3, 3) or ({count}, 3, 3), got shape {given.shape}"
        )
    every = np.broadcast_to(given, (count, 3, 3)).copy()
    scale = np.abs(every).max(axis=(1, 2))
    for index, matrix in enumerate(every):
        symmetric = np.allclose(matrix, matrix.T, rtol=0, atol=1e-9 * scale[index])
        least = np.linalg.eigvalsh((matrix + matrix.T) / 2)[0]
        if not symmetric or least <= 1e-12 * scale[index]:
            raise InputError(
                f"{name}: expected symmetric, positive definite matrices; fiducial {index} has "
                f"{matrix.tolist()} (smallest eigenvalue {least:.3g} mm^2)"
            )
    return every
