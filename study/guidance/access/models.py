"""How a robot's drilled lines err: drawn from a few numbers, from an array, or as the paper prints.

A model draws ``sample(n, rng) -> (n, 2, 3)``: mm by which the axis misses its entry and its target, in the
axes of the drill (`study.guidance.access.drill_axes`: two across, one along).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from study import published
from study.errors import InputError
from study.guidance.access.axes import checked_errors
from study.registration.sources import checked_std

#: Rows of Baron's table 1: where the drill enters, and where it comes out.
PRINTED_SYSTEMS = ("hannover", "vanderbilt")


@runtime_checkable
class LineErrorModel(Protocol):
    """Anything whose drilled lines err."""

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 2, 3) mm at entry and target, axes of the drill."""
        ...


@dataclass(frozen=True, eq=False)
class NormalErrors:
    """Normal errors of entry and target.

    Parameters
    ----------
    entry_std, target_std : float or (3,) array
        mm along each of the drill's axes (across, across, along).
    correlation : float
        Between the errors of entry and target along the same axis, -1 to 1. Registration and calibration
        shift both ends of a hole alike, noise does not. The paper prints none; 1, the default, is the
        cautious end for what lies between entry and target.
    bias : (2, 3) array
        mm, of entry and of target.

    Raises
    ------
    InputError
        If a value is negative, not finite or of another shape.
    """

    entry_std: ArrayLike
    target_std: ArrayLike
    correlation: float = 1.0
    bias: ArrayLike = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def __post_init__(self) -> None:
        for name in ("entry_std", "target_std"):
            object.__setattr__(self, name, checked_std(name, getattr(self, name), "mm", (3,)))
        if not (np.isscalar(self.correlation) and -1 <= self.correlation <= 1):
            raise InputError(f"correlation: expected a number from -1 to 1, got {self.correlation!r}")
        bias = np.array(self.bias, dtype=float)
        if bias.shape != (2, 3) or not np.isfinite(bias).all():
            raise InputError(
                f"bias: expected finite mm of shape (2, 3), got {np.asarray(self.bias).tolist()}"
            )
        object.__setattr__(self, "bias", bias)

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 2, 3) mm at entry and target, axes of the drill."""
        unit = np.random.default_rng(rng).standard_normal((n, 2, 3))
        own = np.sqrt(1.0 - self.correlation**2)
        out = np.empty((n, 2, 3))
        out[:, 1] = unit[:, 0] * self.target_std
        out[:, 0] = (self.correlation * unit[:, 0] + own * unit[:, 1]) * self.entry_std
        return out + self.bias


@dataclass(frozen=True, eq=False)
class DrawnErrors:
    """Errors that were found elsewhere, by experiments on blocks or by simulated ones.

    Parameters
    ----------
    errors : (m, 2, 3) array
        mm at entry and target, axes of the drill.

    Raises
    ------
    InputError
        If it has another shape or a value is not finite.
    """

    errors: ArrayLike

    def __post_init__(self) -> None:
        object.__setattr__(self, "errors", checked_errors(self.errors))

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 2, 3) mm: as many of them as are there in random order, more with repetition."""
        rng = np.random.default_rng(rng)
        count = len(self.errors)
        rows = rng.permutation(count)[:n] if n <= count else rng.integers(count, size=n)
        return self.errors[rows]


@dataclass(frozen=True, eq=False)
class FittedErrors:
    """Normal errors with the mean and the whole covariance of errors that were found elsewhere.

    For a few hundred simulated holes whose tail is asked for: what happens once in a thousand is then the
    normal distribution's word, not the simulation's.

    Parameters
    ----------
    mean : (2, 3) array
        mm, of entry and target, axes of the drill.
    covariance : (6, 6) array
        mm^2, those of the entry first; symmetric, without negative eigenvalues.

    Raises
    ------
    InputError
        If it has another shape, or is no covariance.
    """

    mean: ArrayLike
    covariance: ArrayLike

    def __post_init__(self) -> None:
        mean, covariance = np.array(self.mean, dtype=float), np.array(self.covariance, dtype=float)
        if mean.shape != (2, 3) or not np.isfinite(mean).all():
            raise InputError(f"mean: expected finite mm of shape (2, 3), got shape {mean.shape}")
        if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
            raise InputError(
                f"covariance: expected finite mm^2 of shape (6, 6), got shape {covariance.shape}"
            )
        size = np.abs(covariance).max()
        if np.abs(covariance - covariance.T).max() > 1e-9 * size:
            raise InputError("covariance: expected a symmetric matrix")
        if np.linalg.eigvalsh(covariance).min() < -1e-9 * size:
            raise InputError("covariance: expected no negative eigenvalue")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    @classmethod
    def of(cls, errors: ArrayLike) -> FittedErrors:
        """Fit to (n, 2, 3) errors, axes of the drill, mm; at least two."""
        errors = checked_errors(errors)
        if len(errors) < 2:
            raise InputError(f"errors: expected at least two to fit, got {len(errors)}")
        return cls(errors.mean(axis=0), np.cov(errors.reshape(len(errors), 6).T))

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 2, 3) mm at entry and target, axes of the drill."""
        values, vectors = np.linalg.eigh(self.covariance)
        unit = np.random.default_rng(rng).standard_normal((n, 6))
        drawn = unit @ (vectors * np.sqrt(np.maximum(values, 0.0))).T
        return self.mean + drawn.reshape(n, 2, 3)


@dataclass(frozen=True, eq=False)
class AnyRoll:
    """Errors of a robot of which nobody knows how it stands about the drill.

    A bias of half a millimetre does no harm along the nerve and much across; each draw is turned about the
    drill by an angle of its own.

    Parameters
    ----------
    model : LineErrorModel
    """

    model: LineErrorModel

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 2, 3) mm at entry and target, axes of the drill."""
        rng = np.random.default_rng(rng)
        drawn = checked_errors(self.model.sample(n, rng))
        roll = rng.uniform(0.0, 2.0 * np.pi, n)[:, None]
        x, y = drawn[..., 0].copy(), drawn[..., 1].copy()
        drawn[..., 0] = np.cos(roll) * x - np.sin(roll) * y
        drawn[..., 1] = np.sin(roll) * x + np.cos(roll) * y
        return drawn


def printed_lateral(system: str, correlation: float = 1.0) -> NormalErrors:
    """Normal errors with the means and standard deviations that Baron's table 1 prints for 24 holes.

    The holes' top side is the entry, the bottom side the target. Depth was not measured: no error along.

    Parameters
    ----------
    system : {"hannover", "vanderbilt"}
    correlation : float
        Not printed, see `NormalErrors`.

    Raises
    ------
    InputError
        If the system is another.
    """
    if system not in PRINTED_SYSTEMS:
        raise InputError(f"system: expected one of {PRINTED_SYSTEMS}, got {system!r}")
    rows = published.table("Baron 1").set_index(["system", "side"]).loc[system]
    rows = rows.loc[["top", "bottom"]]
    none = np.zeros(2)
    bias = np.column_stack([rows["mean_x_mm"], rows["mean_y_mm"], none])
    std = np.column_stack([rows["std_x_mm"], rows["std_y_mm"], none])
    return NormalErrors(std[0], std[1], correlation, bias)


def printed_absolute() -> NormalErrors:
    """Normal errors as large as the distances that Baron prints for six holes (6.4).

    Printed are mean and standard deviation of two distances at the target: between drilled and desired
    point, and between the two axes. Their mean squares give the variance across and, by difference, along;
    how much of it is bias and which way it points is not printed, so all of it is scatter here, the same
    in all directions across, and the same at the entry.
    """
    rows = published.table("Baron absolute accuracy").set_index("measure")
    squares = rows["mean_mm"] ** 2 + rows["std_mm"] ** 2
    whole = squares["drilled_target_to_desired_target_distance"]
    across = squares["mid_axis_to_mid_axis_distance_at_target"]
    std = np.sqrt([across / 2, across / 2, whole - across])
    return NormalErrors(std, std)
