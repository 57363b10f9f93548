"""Registration of the image to the patient by spheres, which notices spheres that do not correspond.

Baron, section 4.2: the spheres' centres are found in the image, touched on the patient, and brought onto
each other by `study.registration.register_points`, which equation 4 describes. A residual that is too large
for the error of localisation means that the spheres were touched in another order or that one has moved.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from study.errors import CorrespondenceError, InputError
from study.registration.point import FLE_RMS
from study.registration.rigid import checked_fiducials, register_many, register_points

#: Localisation error of both spaces together, mm: root of the mean squared 3-D length.
LOCALISATION_RMS = np.sqrt(2.0) * FLE_RMS
#: Up to so many spheres all orders are tried; of more, those that exchange two.
MOST_SPHERES = 8
# Orders registered at once.
_CHUNK = 500


@dataclass(frozen=True, eq=False)
class SphereRegistration:
    """The image registered to the patient's marker.

    Attributes
    ----------
    T_pat_img : (4, 4) array
    residuals : (n, 3) array
        Image's spheres on the patient minus the touched ones, mm, patient's axes.
    fre : float
        Root of the mean squared residual, mm.
    tolerance_mm : float
        Largest `fre` that was taken.
    order : tuple of int
        Of the patient's spheres, as given.
    equivalent : tuple of tuple of int
        Other orders of the patient's spheres whose residual is not too large either: the layout is too
        symmetric for the residual to tell an exchange. Empty where the residual settles the order.
    """

    T_pat_img: np.ndarray
    residuals: np.ndarray
    fre: float
    tolerance_mm: float
    order: tuple[int, ...]
    equivalent: tuple[tuple[int, ...], ...]

    @property
    def ambiguous(self) -> bool:
        """Whether spheres touched in another order would have gone unnoticed."""
        return bool(self.equivalent)


def residual_tolerance(
    count: int, localisation_rms_mm: float = LOCALISATION_RMS, confidence: float = 0.999
) -> float:
    """Fiducial registration error, mm, that spheres which correspond exceed with a small probability.

    ``N FRE^2 / s^2`` is chi-squared distributed with 3 N - 6 degrees of freedom where localisation errs
    normally and alike in all directions, with s per axis.

    Parameters
    ----------
    count : int
        Spheres.
    localisation_rms_mm : float
        Both spaces together, 3-D.
    confidence : float
        Share of right registrations that is taken.

    Raises
    ------
    InputError
        If there are fewer than three spheres or a number has no meaning.
    """
    if count < 3:
        raise InputError(f"count: expected at least 3 spheres, got {count}")
    if not np.isfinite(localisation_rms_mm) or localisation_rms_mm <= 0:
        raise InputError(f"localisation_rms_mm: expected mm above 0, got {localisation_rms_mm!r}")
    if not 0 < confidence < 1:
        raise InputError(f"confidence: expected a share between 0 and 1, got {confidence!r}")
    return float(localisation_rms_mm * np.sqrt(chi2.ppf(confidence, 3 * count - 6) / (3 * count)))


def register_spheres(
    image: ArrayLike,
    patient: ArrayLike,
    tolerance_mm: float | None = None,
    localisation_rms_mm: float = LOCALISATION_RMS,
    confidence: float = 0.999,
) -> SphereRegistration:
    """Register the image to the patient by corresponding spheres, and refuse those that do not correspond.

    Parameters
    ----------
    image, patient : (n, 3) arrays
        Centres in the image and as touched on the patient, mm; three or more, not on one line.
    tolerance_mm : float, optional
        Largest fiducial registration error that is taken; from the two arguments below by default.
    localisation_rms_mm, confidence : float
        See `residual_tolerance`.

    Returns
    -------
    SphereRegistration

    Raises
    ------
    CorrespondenceError
        If the residual is too large: with the order of the patient's spheres that makes it small, or, where
        none does, with the sphere that has probably moved.
    InputError
        If there are too few spheres, they lie on a line, the lists differ in length or a number is wrong.
    """
    image = checked_fiducials("image", image)
    patient = checked_fiducials("patient", patient)
    if image.shape != patient.shape:
        raise InputError(f"patient: expected {len(image)} spheres like the image, got {len(patient)}")
    n = len(image)
    if tolerance_mm is None:
        tolerance_mm = residual_tolerance(n, localisation_rms_mm, confidence)
    elif not np.isfinite(tolerance_mm) or tolerance_mm <= 0:
        raise InputError(f"tolerance_mm: expected mm above 0, got {tolerance_mm!r}")
    fit = register_points(image, patient)
    given = tuple(range(n))
    good, best = _search(image, patient, tolerance_mm)
    others = tuple(order for order in good if order != given)
    if fit.fre <= tolerance_mm:
        return SphereRegistration(fit.transform, fit.residuals, fit.fre, tolerance_mm, given, others)
    start = f"residual: expected at most {tolerance_mm:.3f} mm, got {fit.fre:.3f} mm; "
    if others:
        more = ""
        if len(others) > 1:
            more = f"; {len(others) - 1} more orders would do as well, the layout is symmetric"
        raise CorrespondenceError(
            f"{start}the spheres do not correspond as given: the patient's in the order {list(others[0])} "
            f"leave {_fre(image, patient, others[0]):.3f} mm{more}",
            others[0],
        )
    tried = "no order of the patient's spheres" if n <= MOST_SPHERES else "no exchange of two spheres"
    raise CorrespondenceError(
        f"{start}{tried} makes it small (best {best:.3f} mm); {_moved_sphere(image, patient)}"
    )


def find_order(image: ArrayLike, patient: ArrayLike) -> tuple[int, ...]:
    """Order of the patient's spheres in which they correspond best to the image's.

    Parameters
    ----------
    image, patient : (n, 3) arrays
        mm; three to eight of each, not on one line.

    Returns
    -------
    tuple of int
        ``patient[list(order)]`` corresponds to ``image``.

    Raises
    ------
    InputError
        If there are too few or too many, they lie on a line or the lists differ in length.
    """
    image = checked_fiducials("image", image)
    patient = checked_fiducials("patient", patient)
    if image.shape != patient.shape or len(image) > MOST_SPHERES:
        raise InputError(
            f"patient: expected as many spheres as in the image, at most {MOST_SPHERES}, "
            f"got {len(image)} and {len(patient)}"
        )
    return _search(image, patient, 0.0, always=True)[0][0]


def _search(
    image: np.ndarray, patient: np.ndarray, tolerance: float, always: bool = False
) -> tuple[list[tuple[int, ...]], float]:
    """Orders whose residual is within a tolerance, best first, and the smallest residual of all, mm.

    With `always` the best order is the first whatever its residual. Distances between spheres bound an
    order's residual from below: the sum over pairs of their squared differences is at most ``(n FRE)^2``.
    Orders are taken by that bound, so that few are registered and none is missed.
    """
    orders = _orders(len(image))
    rows, columns = np.triu_indices(len(image), 1)
    wanted = np.linalg.norm(image[rows] - image[columns], axis=1)
    between = np.linalg.norm(patient[:, None] - patient, axis=2)
    off = between[orders[:, rows], orders[:, columns]] - wanted
    bounds = np.sqrt(np.einsum("ij,ij->i", off, off)) / len(image)
    by_bound = np.argsort(bounds, kind="stable")
    good: list[tuple[float, tuple[int, ...]]] = []
    best, first = np.inf, tuple(range(len(image)))
    for start in range(0, len(by_bound), _CHUNK):
        part = by_bound[start : start + _CHUNK]
        if bounds[part[0]] > max(best, tolerance):
            break
        fres = _fres(image, patient, orders[part])
        least = int(np.argmin(fres))
        if fres[least] < best:
            best, first = float(fres[least]), tuple(orders[part[least]].tolist())
        good += [(fres[k], tuple(orders[part[k]].tolist())) for k in np.flatnonzero(fres <= tolerance)]
    good.sort()
    return [first] if always else [order for _, order in good], best


@cache
def _orders(n: int) -> np.ndarray:
    """(m, n) orders to try, the given one first."""
    if n <= MOST_SPHERES:
        return np.array(list(itertools.permutations(range(n))), dtype=np.intp)
    rows, columns = np.triu_indices(n, 1)
    orders = np.tile(np.arange(n), (len(rows) + 1, 1))
    exchanged = np.arange(1, len(orders))
    orders[exchanged, rows], orders[exchanged, columns] = columns, rows
    return orders


def _fres(image: np.ndarray, patient: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """(m,) fiducial registration errors, mm, of the patient's spheres in orders."""
    fixed = patient[orders]
    moving = np.broadcast_to(image, fixed.shape)
    T = register_many(moving, fixed, np.ones(len(image)))
    residuals = image @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3] - fixed
    return np.sqrt((residuals**2).sum(axis=2).mean(axis=1))


def _fre(image: np.ndarray, patient: np.ndarray, order: tuple[int, ...]) -> float:
    return float(_fres(image, patient, np.array([order]))[0])


def _moved_sphere(image: np.ndarray, patient: np.ndarray) -> str:
    """Says which sphere has probably moved: the one without which the others fit best."""
    n = len(image)
    if n == 3:
        rows, columns = np.triu_indices(n, 1)
        off = np.linalg.norm(patient[rows] - patient[columns], axis=1)
        off -= np.linalg.norm(image[rows] - image[columns], axis=1)
        k = int(np.argmax(np.abs(off)))
        return (
            f"of three spheres it cannot be told which has moved; the distance between {rows[k]} and "
            f"{columns[k]} differs most, by {off[k]:+.3f} mm on the patient"
        )
    left = []
    for k in range(n):
        rest = np.delete(np.arange(n), k)
        left.append(_fre(image[rest], patient[rest], tuple(range(n - 1))))
    k = int(np.argmin(left))
    return f"sphere {k} has probably moved: without it the others leave {left[k]:.3f} mm"
