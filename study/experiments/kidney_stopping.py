"""What iterative closest point fits have made of their starts when they are stopped, and in the end.

The text prints neither a tolerance nor a number of iterations (Siebold, 4.2.2), and how far registrations
scatter depends on both. Here one set of starts is followed from stop to stop; nothing else is random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from study.errors import InputError
from study.experiments.kidney_draws import scatter_at
from study.registration import IcpSettings, SurfaceRegistration, register_surface

#: Numbers of iterations at which the way is looked at.
STOPS = (1, 2, 5, 10, 20, 50, 100)
#: Of these, the ones that the table lists.
LISTED = (0, 5, 20, 50)
#: Residual over the median one, above which somebody who looks at it would register again.
_SUSPECT = 1.5
#: Factor from which on words call a change one.
_MATTERS = 1.5
#: Worst in a hundred over the median from which on it is said to be elsewhere.
_TAIL = 3.0


@dataclass(frozen=True, eq=False)
class FitsOnTheWay:
    """Fits of one set of starts at several stops.

    Attributes
    ----------
    stops : tuple of int
        Iterations; the first is 0, the start itself, the last the most that were allowed.
    transforms : (k, n, 4, 4) array
        Where the patch's true points are put at each stop, mm.
    converged : (k, n) bool array
        Nothing moves any more at that stop or did before.
    iterations : (k, n) int array
        Made so far.
    residual : (k, n) array
        Root mean squared distance from the patch to the nearest vertices, mm; NaN before the first fit.
    """

    stops: tuple[int, ...]
    transforms: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray
    residual: np.ndarray

    def __len__(self) -> int:
        return self.transforms.shape[1]

    def errors_at(self, points: ArrayLike) -> np.ndarray:
        """(k, n) root mean squared registration error over (m, 3) points, mm."""
        return _errors(self.transforms, np.asarray(points, dtype=float))

    def shown(self, point: ArrayLike, stops: Sequence[int] = LISTED[1:]) -> dict[str, np.ndarray]:
        """From a point (mm) to where registrations show it, (n, 3) mm, at some stops and in the end."""
        point = np.asarray(point, dtype=float)
        last = len(self.stops) - 1
        return {
            _name(stop, k == last): self.transforms[k, :, :3, :3] @ point
            + self.transforms[k, :, :3, 3]
            - point
            for k, stop in enumerate(self.stops)
            if stop in stops or k == last
        }


def fits_on_the_way(
    model: SurfaceRegistration,
    registrations: int,
    rng: object = None,
    stops: Sequence[int] = STOPS,
    settings: IcpSettings | None = None,
) -> FitsOnTheWay:
    """Follow the fits of one set of starts from stop to stop until they converge.

    The patch is the true one and all vertices take part, so that the starts alone make the difference. What
    a fit does next depends on where it is and on nothing else: the stops lie on one way.

    Parameters
    ----------
    model : SurfaceRegistration
        Says how starts scatter.
    registrations : int
    rng : anything `numpy.random.default_rng` takes
    stops : sequence of int
        Iterations, growing.
    settings : IcpSettings, optional
        When a fit has converged; the strict default.

    Raises
    ------
    InputError
        If stops are no growing positive numbers below the most iterations.
    """
    settings = IcpSettings() if settings is None else settings
    every = (0, *(int(stop) for stop in stops), settings.max_iterations)
    if any(a >= b for a, b in pairwise(every)):
        raise InputError(
            f"stops: expected growing numbers from 1 to {settings.max_iterations - 1}, got {list(stops)}"
        )
    starts = model.starts(registrations, rng)
    transforms = np.tile(starts, (len(every), 1, 1, 1))
    converged = np.zeros((len(every), len(starts)), bool)
    iterations = np.zeros((len(every), len(starts)), int)
    residual = np.full((len(every), len(starts)), np.nan)
    for k in range(1, len(every)):
        for kept in (transforms, converged, iterations, residual):
            kept[k] = kept[k - 1]
        going = np.flatnonzero(~converged[k])
        if len(going):
            leg = replace(settings, max_iterations=every[k] - every[k - 1])
            fits = register_surface(model.tree, model.patch, transforms[k][going], leg)
            transforms[k][going], converged[k][going] = fits.transforms, fits.converged
            iterations[k][going] += fits.iterations
            residual[k][going] = fits.rms
    return FitsOnTheWay(every, transforms, converged, iterations, residual)


def stopping_table(fits: FitsOnTheWay, points: ArrayLike, listed: Sequence[int] = LISTED) -> pd.DataFrame:
    """How far registrations scatter at the tumour, stop by stop.

    Parameters
    ----------
    fits : FitsOnTheWay
    points : (m, 3) array_like
        Such as the tumour's voxels, mm.
    listed : sequence of int
        Stops of which there is a row; the last one always has one.

    Returns
    -------
    DataFrame
        One row a stop: ``tre_mm`` root mean squared over registrations and points; ``bias_mm`` and
        ``scatter_mm``, the parts of it that are the same in all registrations and that are not;
        ``median_mm`` and ``worst_1_in_100_mm``, quantiles over registrations; ``converged_pct``;
        ``iterations`` on average; ``residual_mm`` of the patch, the median; ``checked_pct`` of the
        registrations have a residual of at most 1.5 times that, ``checked_worst_mm`` is the worst in a
        hundred of them.
    """
    points = np.asarray(points, dtype=float)
    errors = fits.errors_at(points)
    rows = {}
    for k, stop in enumerate(fits.stops):
        last = k == len(fits.stops) - 1
        if stop in listed or last:
            rows[_name(stop, last)] = _row(
                fits.transforms[k], points, errors[k], fits.converged[k], fits.iterations[k], fits.residual[k]
            )
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("stopped")


def drawn_row(model: SurfaceRegistration, registrations: int, points: ArrayLike, rng: object = None) -> dict:
    """The same columns for registrations as a model draws them, with all that it makes random."""
    fits = model.register(registrations, rng)
    points = np.asarray(points, dtype=float)
    errors = _errors(fits.transforms, points)
    return _row(fits.transforms, points, errors, fits.converged, fits.iterations, fits.rms)


def denser_rows(
    surface: object,
    swab: np.ndarray,
    points: ArrayLike,
    registrations: int,
    rng: object = None,
    times: int = 2,
    **model: float,
) -> pd.DataFrame:
    """Converged fits on denser surfaces: matches are vertices, and may be all that holds a fit where it is.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Each of its triangles is cut into four, `times` times over; its shape stays.
    swab : (p, 3) array
        mm.
    points : (m, 3) array_like
        mm.
    registrations : int
    rng : anything `numpy.random.default_rng` takes
    times : int
    **model
        Further arguments of `study.registration.SurfaceRegistration`, such as ``position_std``.

    Returns
    -------
    DataFrame
        Columns of `stopping_table`, and ``spacing_mm`` from a vertex to the nearest, the median.
    """
    rows = {}
    for step in range(times + 1):
        fits = fits_on_the_way(SurfaceRegistration(surface, swab, **model), registrations, rng, stops=(1,))
        row = stopping_table(fits, points, listed=()).iloc[-1]
        near, _ = cKDTree(surface.vertices).query(surface.vertices[:: 1 + len(surface.vertices) // 2000], k=2)
        name = f"{4**step} times the vertices" if step else "vertices as they are"
        rows[name] = {"spacing_mm": float(np.median(near[:, 1])), **row}
        if step < times:
            surface = surface.subdivide()
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("converged on")


def _name(stop: int, last: bool) -> str:
    if last:
        return "converged"
    return f"after {stop}" if stop else "not begun"


def _errors(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(...) root mean squared displacement of points by (..., 4, 4) transforms, mm."""
    centre = points.mean(axis=0)
    arms = np.column_stack([points - centre, np.ones(len(points))])
    second = arms.T @ arms / len(points)
    motion = transforms[..., :3, :] - np.eye(4)[:3]
    motion[..., 3] += motion[..., :3] @ centre
    return np.sqrt(np.einsum("...ai,ij,...aj->...", motion, second, motion, optimize=True))


def _row(transforms, points, errors, converged, iterations, residual) -> dict[str, float]:
    scatter = scatter_at(transforms, points)
    checked = ~(residual > _SUSPECT * np.median(residual))
    return {
        "tre_mm": float(np.sqrt((errors**2).mean())),
        "bias_mm": scatter.bias_mm,
        "scatter_mm": scatter.scatter_mm,
        "median_mm": float(np.median(errors)),
        "worst_1_in_100_mm": float(np.quantile(errors, 0.99)),
        "converged_pct": 100 * float(converged.mean()),
        "iterations": float(iterations.mean()),
        "residual_mm": float(np.median(residual)),
        "checked_pct": 100 * float(checked.mean()),
        "checked_worst_mm": float(np.quantile(errors[checked], 0.99)),
    }


def stopping_words(table: pd.DataFrame) -> str:
    """What a stopping table says, in words that follow from its numbers (Markdown).

    Parameters
    ----------
    table : DataFrame
        Of `stopping_table`.
    """
    begun, *stopped, end = table.index
    tre, median, rested = table["tre_mm"], table["median_mm"], table["converged_pct"]
    ratio = max(tre[name] / max(tre[end], 1e-9) for name in stopped)
    listed = ", ".join(f"{tre[name]:.2f} mm {name} iterations" for name in stopped)
    text = [
        f"As they start, registrations are {tre[begun]:.1f} mm off at the tumour (root mean square). They "
        f"are {listed}, and {tre[end]:.2f} mm once nothing moves any more, which takes "
        f"{table.loc[end, 'iterations']:.0f} iterations on average. "
    ]
    if ratio >= _MATTERS:
        text[0] += (
            f"**How far registrations scatter depends on when the fit is stopped**: by a factor of up to "
            f"{ratio:.1f} here, with the same kidney, swab and starts."
        )
    else:
        text[0] += (
            f"On this kidney the stop hardly matters: it changes that by a factor of {ratio:.2f} at most."
        )
    text.append(
        "Of the fits have come to rest: "
        + ", ".join(f"{rested[name]:.0f} % {name}" for name in stopped)
        + f", {rested[end]:.0f} % in the end. What a fit makes small, the distance from the swab to the "
        f"surface, hardly tells how far it has come: its median is "
        f"{table.loc[stopped[-1], 'residual_mm']:.2f} mm {stopped[-1]} iterations and "
        f"{table.loc[end, 'residual_mm']:.2f} mm in the end."
    )
    tail, checked = table.loc[end, "worst_1_in_100_mm"], table.loc[end, "checked_worst_mm"]
    if tail < _TAIL * median[end]:
        text.append(
            f"In the end one in a hundred is {tail:.2f} mm off or more, half of them {median[end]:.2f} mm."
        )
        return "\n\n".join(text)
    text.append(
        f"Not all fits end at the same place. Half of them are within {median[end]:.2f} mm of the truth, but "
        f"one in a hundred comes to rest {tail:.1f} mm from it or farther. A margin for a risk of one in a "
        "hundred is made by those, not by the root mean square. "
    )
    if checked * _MATTERS < tail:
        text[-1] += (
            f"These give themselves away: of the {table.loc[end, 'checked_pct']:.1f} % of fits whose "
            f"distance from the surface is at most {_SUSPECT:g} times the median one, one in a hundred is "
            f"{checked:.2f} mm off. Somebody who looks at that distance and registers again needs a smaller "
            "margin."
        )
    else:
        text[-1] += "Their distance from the surface does not give them away."
    return "\n\n".join(text)


def denser_words(table: pd.DataFrame) -> str:
    """What `denser_rows` says (Markdown).

    Parameters
    ----------
    table : DataFrame
    """
    first, last = table.iloc[0], table.iloc[-1]
    if len(table) == 1:
        return (
            f"With vertices {first['spacing_mm']:.2f} mm apart the median error of converged fits is "
            f"{first['median_mm']:.2f} mm; denser ones were not asked for."
        )
    change = first["median_mm"] / max(last["median_mm"], 1e-9)
    text = (
        f"With vertices {first['spacing_mm']:.2f} mm apart the median error of converged fits is "
        f"{first['median_mm']:.2f} mm, with vertices {last['spacing_mm']:.2f} mm apart "
        f"{last['median_mm']:.2f} mm; one in a hundred is off by {first['worst_1_in_100_mm']:.1f} and "
        f"{last['worst_1_in_100_mm']:.1f} mm. "
    )
    if change >= _MATTERS:
        text += (
            f"So {1 - 1 / change:.0%} at least of what a typical converged fit is off by is no uncertainty "
            "of the patch: it is the lattice of vertices, between which a fit that matches points with "
            "vertices comes to rest. "
        )
    else:
        text += "So the vertices' spacing is not what a typical converged fit is off by. "
    if first["worst_1_in_100_mm"] >= _MATTERS * last["worst_1_in_100_mm"]:
        text += "The worst come down with it."
    elif last["worst_1_in_100_mm"] >= _TAIL * last["spacing_mm"]:
        text += "The worst stay, and far beyond a vertex: they lie in other minima."
    return text.rstrip()
