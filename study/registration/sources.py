"""What can go wrong between image and patient, as transforms that can be drawn.

An error source says where an image point lands instead of itself: ``sample(n, rng)`` returns (n, 4, 4)
transforms in mm, image axes. Registration is one source; others (Siebold, 3.4, names calibration, joints,
compliance) are composed with it. A source that knows its covariance says so by ``moments()``; for one that
does not it is estimated from draws. An error that changes while the bone is milled is not one transform:
enter its worst.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.registration.moments import DisplacementMoments, sampled_moments

#: Draws from which the covariance of a source is estimated that does not know it.
_MOMENT_DRAWS = 20_000


@runtime_checkable
class ErrorSource(Protocol):
    """Anything whose error is one affine transform a procedure."""

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms: where an image point lands instead of itself, mm, image axes."""
        ...


def displacement_moments(source: ErrorSource) -> DisplacementMoments:
    """Covariance of the displacement that a source causes, from itself or from 20 000 draws of it.

    Raises
    ------
    InputError
        If it is not an error source or its transforms are not (n, 4, 4).
    """
    checked_source(source)
    if hasattr(source, "moments"):
        return source.moments()
    return sampled_moments(checked_transforms(source, _MOMENT_DRAWS, np.random.default_rng(0)))


def checked_source(source: ErrorSource) -> None:
    """Refuse what cannot be drawn from.

    Raises
    ------
    InputError
        If it has no ``sample``, or is a class and not one of its instances.
    """
    if not isinstance(source, ErrorSource) or isinstance(source, type):
        what = f"the class {source.__name__}" if isinstance(source, type) else type(source).__name__
        raise InputError(
            f"model: expected an error source with sample(n, rng), such as PointRegistration(...); got {what}"
        )


def checked_transforms(source: ErrorSource, n: int, rng: np.random.Generator) -> np.ndarray:
    """(n, 4, 4) affine transforms drawn from a source.

    Raises
    ------
    InputError
        If it has no ``sample``, or that returns something else.
    """
    checked_source(source)
    drawn = np.asarray(source.sample(n, rng), dtype=float)
    if drawn.shape != (n, 4, 4):
        raise InputError(f"{type(source).__name__}.sample: expected shape {(n, 4, 4)}, got {drawn.shape}")
    if not np.isfinite(drawn).all() or not np.array_equal(drawn[:, 3], np.broadcast_to([0, 0, 0, 1], (n, 4))):
        raise InputError(f"{type(source).__name__}.sample: expected finite transforms with last row 0 0 0 1")
    return drawn


def checked_vector(name: str, value: ArrayLike, unit: str) -> np.ndarray:
    """(3,) finite float array.

    Raises
    ------
    InputError
        If it is not.
    """
    vector = np.array(value, dtype=float)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name}: expected three finite numbers in {unit}, got {np.asarray(value).tolist()}")
    return vector


def checked_std(name: str, value: ArrayLike, unit: str, shape: tuple[int, ...] = ()) -> np.ndarray:
    """Standard deviations of a shape (or one for all), finite and at least 0.

    Raises
    ------
    InputError
        If they are not.
    """
    array = np.array(value, dtype=float)
    if array.shape not in ((), shape) or not np.isfinite(array).all() or (array < 0).any():
        wanted = f"a number or an array of shape {shape}" if shape else "a number"
        raise InputError(f"{name}: expected {wanted} of at least 0 {unit}, got {np.asarray(value).tolist()}")
    return np.broadcast_to(array, shape).copy()


@dataclass(frozen=True, eq=False)
class ImageError:
    """An image whose voxels are not quite where its header says, and structures not quite where segmented.

    Parameters
    ----------
    centre : (3,) array
        About which the scale errs, mm: where the image was made to fit, such as the fiducials' centroid.
    scale_std : float or (3,) array
        Relative error of distances along each image axis; 0.001 is 0.1 mm on 100 mm.
    position_std : float or (3,) array
        Error of a structure's position as a whole, along each image axis, mm.

    Raises
    ------
    InputError
        If a value is negative, not finite or of another shape.
    """

    centre: ArrayLike
    scale_std: ArrayLike = 0.0
    position_std: ArrayLike = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", checked_vector("centre", self.centre, "mm"))
        object.__setattr__(self, "scale_std", checked_std("scale_std", self.scale_std, "", (3,)))
        object.__setattr__(self, "position_std", checked_std("position_std", self.position_std, "mm", (3,)))

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms, see `ErrorSource`."""
        rng = np.random.default_rng(rng)
        scale = rng.standard_normal((n, 3)) * self.scale_std
        shift = rng.standard_normal((n, 3)) * self.position_std
        out = np.tile(np.eye(4), (n, 1, 1))
        for axis in range(3):
            out[:, axis, axis] += scale[:, axis]
        out[:, :3, 3] = shift - scale * self.centre
        return out

    def moments(self) -> DisplacementMoments:
        """Covariance of the displacement, exact."""
        covariance = np.zeros((3, 4, 3, 4))
        for axis in range(3):
            covariance[axis, axis, axis, axis] = self.scale_std[axis] ** 2
            covariance[axis, 3, axis, 3] = self.position_std[axis] ** 2
        return DisplacementMoments(self.centre, covariance.reshape(12, 12))


@dataclass(frozen=True, eq=False)
class RobotError:
    """A robot that misses its pose and gives way under the cutting force.

    Parameters
    ----------
    centre : (3,) array
        About which the robot's orientation errs, mm; where it is fixed to the patient, say.
    position_std : float or (3,) array
        Of the tool's position, along each image axis, mm.
    rotation_std : float or (3,) array
        Of the tool frame's orientation about each image axis, rad.
    compliance : (3, 3) array
        Displacement under a force, mm/N, symmetric; in image axes.
    force_mean : (3,) array
        Cutting force on the tool, N. Its mean deflection is an offset, not a scatter.
    force_std : float or (3,) array
        Of the force, N.

    Raises
    ------
    InputError
        If a value is negative, not finite, of another shape, or the compliance not symmetric.
    """

    centre: ArrayLike
    position_std: ArrayLike = 0.0
    rotation_std: ArrayLike = 0.0
    compliance: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    force_mean: ArrayLike = (0.0, 0.0, 0.0)
    force_std: ArrayLike = 0.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", checked_vector("centre", self.centre, "mm"))
        object.__setattr__(self, "position_std", checked_std("position_std", self.position_std, "mm", (3,)))
        object.__setattr__(self, "rotation_std", checked_std("rotation_std", self.rotation_std, "rad", (3,)))
        object.__setattr__(self, "force_std", checked_std("force_std", self.force_std, "N", (3,)))
        object.__setattr__(self, "force_mean", checked_vector("force_mean", self.force_mean, "N"))
        compliance = np.array(self.compliance, dtype=float)
        if (
            compliance.shape != (3, 3)
            or not np.isfinite(compliance).all()
            or not np.allclose(compliance, compliance.T, rtol=1e-9, atol=0)
        ):
            raise InputError(
                f"compliance: expected a symmetric (3, 3) matrix in mm/N, got {compliance.tolist()}"
            )
        object.__setattr__(self, "compliance", compliance)

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms, see `ErrorSource`."""
        rng = np.random.default_rng(rng)
        turn = Rotation.from_rotvec(rng.standard_normal((n, 3)) * self.rotation_std).as_matrix()
        shift = rng.standard_normal((n, 3)) * self.position_std
        force = self.force_mean + rng.standard_normal((n, 3)) * self.force_std
        out = np.tile(np.eye(4), (n, 1, 1))
        out[:, :3, :3] = turn
        out[:, :3, 3] = self.centre - turn @ self.centre + shift + force @ self.compliance
        return out

    def moments(self) -> DisplacementMoments:
        """Covariance of the displacement about its mean, to first order in the rotation."""
        motion = np.zeros((6, 6))
        motion[:3, :3] = np.diag(self.rotation_std**2)
        give = self.compliance * self.force_std
        motion[3:, 3:] = np.diag(self.position_std**2) + give @ give.T
        return DisplacementMoments.of_motion(self.centre, motion)


@dataclass(frozen=True, eq=False)
class CombinedErrors:
    """Independent sources, one after the other: the first moves an image point first.

    Parameters
    ----------
    sources : sequence of ErrorSource
        At least one.

    Raises
    ------
    InputError
        If there is none or one cannot be drawn from.
    """

    sources: Sequence[ErrorSource]

    def __post_init__(self) -> None:
        sources = (self.sources,) if isinstance(self.sources, ErrorSource) else tuple(self.sources)
        wrong = [type(source).__name__ for source in sources if not isinstance(source, ErrorSource)]
        if wrong or not sources:
            raise InputError(f"sources: expected error sources with sample(n, rng), got {wrong or 'none'}")
        object.__setattr__(self, "sources", sources)

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms, see `ErrorSource`."""
        rng = np.random.default_rng(rng)
        out = np.tile(np.eye(4), (n, 1, 1))
        for source in self.sources:
            out = checked_transforms(source, n, rng) @ out
        return out

    def moments(self) -> DisplacementMoments:
        """Sum of the sources' covariances, to first order."""
        parts = [displacement_moments(source) for source in self.sources]
        centre = parts[0].centre
        return DisplacementMoments(centre, sum(part.about(centre).covariance for part in parts))
