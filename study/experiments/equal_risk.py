"""Two margins compared at the same risk, off their whole curves and not where growth happened to stop."""

from __future__ import annotations

import numpy as np
import pandas as pd

#: Risks, as multiples of the acceptable one, at which volumes are compared. `SafetyMargin.curve`
#: reaches down to a third.
_MULTIPLES = np.geomspace(1 / 3, 3, 41)


def volumes_at_risks(curve: pd.DataFrame, risks: np.ndarray) -> np.ndarray:
    """mm^3 of the smallest margins of a curve whose risk is at most each of `risks`; NaN beyond the curve."""
    descending = -curve["risk"].to_numpy()
    first = np.searchsorted(descending, -np.asarray(risks), side="left")
    volumes = np.append(curve["volume_mm3"].to_numpy(), np.nan)
    return volumes[first]


def equal_risk_ratio(sv: pd.DataFrame, ut: pd.DataFrame, acceptable_risk: float) -> float:
    """Volume of the spatially varying margin over that of the uniformly thick one at the same risk.

    In-sample risks stop where the rank of one voxel lets them, so the two final margins seldom have the same
    risk. Here both are read off their whole curves at the same risks, a third of the acceptable one to three
    times it; the geometric mean of the ratios evens out the steps.
    """
    risks = acceptable_risk * _MULTIPLES
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.log(volumes_at_risks(sv, risks) / volumes_at_risks(ut, risks))
    ratios = ratios[np.isfinite(ratios)]
    return float(np.exp(ratios.mean())) if len(ratios) else float("nan")
