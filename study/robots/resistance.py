"""Time that bone resistance adds to a predicted milling time (section 2.5.2, Table 2.3).

The robot's trajectory planner foresees no resistance at the burr, so real millings take longer than
predicted. The excess is modelled as a sum of terms, each with a physical reading:

``start``
    once per milling, s: approach, spin-up, retraction;
``removed_cm3``
    per volume of bone cut, s/cm^3: at a given power a burr needs a given time for a volume;
``predicted_time_s``
    per second foreseen: the drives lag by a fixed share;
``contact_length_mm``
    per path length in contact, s/mm: friction, whatever the depth of the cut.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from study.errors import InputError

TERMS = ("start", "removed_cm3", "predicted_time_s", "contact_length_mm")


@dataclass(frozen=True)
class Resistance:
    """A fitted model of the time that a real milling takes beyond the predicted one.

    Attributes
    ----------
    terms : tuple of str
        Which of `TERMS` it uses; none for no resistance at all.
    coefficients : (k,) ndarray
        Seconds per unit of each term.
    covariance : (k, k) ndarray
        Of the coefficients.
    residual_std_s : float
        Standard deviation of a single milling about the model, s.
    freedom : int
        Degrees of freedom of the fit.
    """

    terms: tuple[str, ...]
    coefficients: NDArray[np.float64]
    covariance: NDArray[np.float64]
    residual_std_s: float
    freedom: int

    def excess(self, regressors: Mapping[str, ArrayLike]) -> NDArray[np.float64]:
        """Return the time that resistance adds, s.

        Parameters
        ----------
        regressors : mapping of str to (n,) array_like
            A column for each term but ``start``, in the unit of its name; more columns do no harm.

        Raises
        ------
        InputError
            If a column is missing, not finite or of another length.
        """
        return _design(self.terms, regressors) @ self.coefficients

    def half_width(
        self, regressors: Mapping[str, ArrayLike], confidence: float = 0.95
    ) -> NDArray[np.float64]:
        """Return the half-width of the prediction interval of one more milling, s.

        Parameters
        ----------
        regressors : mapping of str to (n,) array_like
            As for `excess`.
        confidence : float
            Between 0 and 1.
        """
        design = _design(self.terms, regressors)
        variance = self.residual_std_s**2 + np.einsum("ni,ij,nj->n", design, self.covariance, design)
        return stats.t.ppf((1 + confidence) / 2, self.freedom) * np.sqrt(variance)

    def intervals(self, confidence: float = 0.95) -> NDArray[np.float64]:
        """Return the half-widths (k,) of the coefficients' confidence intervals."""
        return stats.t.ppf((1 + confidence) / 2, self.freedom) * np.sqrt(np.diag(self.covariance))


def fit_resistance(
    excess_s: ArrayLike,
    regressors: Mapping[str, ArrayLike],
    terms: Sequence[str] = ("start", "removed_cm3"),
) -> Resistance:
    """Fit the excess of real over predicted milling times by least squares.

    Parameters
    ----------
    excess_s : (n,) array_like
        Real less predicted time of every milling, s.
    regressors : mapping of str to (n,) array_like
        Columns of the terms.
    terms : sequence of str
        Which of `TERMS` to use; an empty one gives the model without resistance.

    Returns
    -------
    Resistance
        The model.

    Raises
    ------
    InputError
        If a term is unknown, a column is missing or not finite, or there are no more millings than terms,
        or the terms cannot be told apart on these millings.
    """
    unknown = [term for term in terms if term not in TERMS]
    if unknown or len(set(terms)) < len(terms):
        raise InputError(f"expected different terms among {', '.join(TERMS)}, got {', '.join(terms)}")
    excess = np.asarray(excess_s, dtype=float)
    if excess.ndim != 1 or not np.all(np.isfinite(excess)):
        raise InputError(f"excess: expected finite times (n,), got shape {excess.shape}")
    design = _design(tuple(terms), regressors, excess.size)
    freedom = excess.size - len(terms)
    if freedom < 1:
        raise InputError(f"{excess.size} millings do not determine {len(terms)} terms and their scatter")
    if np.linalg.matrix_rank(design) < len(terms):
        raise InputError(f"terms {', '.join(terms)} cannot be told apart on these {excess.size} millings")
    coefficients = np.linalg.lstsq(design, excess, rcond=None)[0]
    variance = float(np.sum((excess - design @ coefficients) ** 2) / freedom)
    covariance = variance * np.linalg.inv(design.T @ design)
    return Resistance(tuple(terms), coefficients, covariance, float(np.sqrt(variance)), freedom)


def _design(
    terms: tuple[str, ...], regressors: Mapping[str, ArrayLike], n: int | None = None
) -> NDArray[np.float64]:
    """Return the (n, k) matrix of the terms' columns."""
    missing = [term for term in terms if term != "start" and term not in regressors]
    if missing:
        raise InputError(f"no column for {', '.join(missing)}; there are: {', '.join(regressors) or 'none'}")
    columns = {term: np.asarray(regressors[term], dtype=float) for term in terms if term != "start"}
    if n is None:
        # a model of the start alone, or of nothing, still answers for every row that is asked about
        n = next((np.size(regressors[name]) for name in (*columns, *regressors)), 1)
    for term, values in columns.items():
        if values.shape != (n,) or not np.all(np.isfinite(values)):
            raise InputError(f"{term}: expected {n} finite numbers in a row, got shape {values.shape}")
    stacked = [columns[term] if term in columns else np.ones(n) for term in terms]
    return np.column_stack(stacked) if stacked else np.zeros((n, 0))
