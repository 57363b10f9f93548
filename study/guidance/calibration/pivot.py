"""Calibration of a tip by pivoting a marker about it (Baron, section 4.3: Vanderbilt's way)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.guidance.calibration.turns import (
    LEAST_SPREAD,
    checked_spread,
    equations,
    sandwich,
    solve_turned,
)
from study.transforms import checked_transforms


@dataclass(frozen=True, eq=False)
class PivotCalibration:
    """Where the tip is in both frames that turned about it.

    Attributes
    ----------
    tip_tool, tip_ref : (3,) arrays
        mm.
    residuals : (n, 3) array
        Tip of each pose minus `tip_ref`, mm, reference's axes.
    covariance : (6, 6) array
        Of `tip_tool`, then `tip_ref`, mm^2, from the residuals: what jitter leaves. A distortion of the
        tracker and a tip that slips or bends are not in it.
    spread : float
        Root mean squared turn of the direction that turned least, rad.
    """

    tip_tool: np.ndarray
    tip_ref: np.ndarray
    residuals: np.ndarray
    covariance: np.ndarray
    spread: float

    @property
    def residual_rms(self) -> float:
        """Root of the mean squared length of the residuals, mm."""
        return float(np.sqrt((self.residuals**2).sum(axis=1).mean()))


def calibrate_pivot(T_ref_tool: ArrayLike, least_spread: float = LEAST_SPREAD) -> PivotCalibration:
    """Find the one point that stays where two frames turn about it, by least squares.

    ``R_i tip_tool + p_i = tip_ref``. Either frame may be the one that moves: Vanderbilt pivots a marker with
    a detent (``ref``) about the tip of the drill, whose marker (``tool``) stands still.

    Parameters
    ----------
    T_ref_tool : (n, 4, 4) array
        Measured poses; three or more, turned about two axes at least.
    least_spread : float
        Smallest `turn_spread` that is taken, rad.

    Returns
    -------
    PivotCalibration

    Raises
    ------
    CalibrationError
        If the poses are too few or turn too little about more than one axis; says how much they do.
    InputError
        If a pose is not rigid.

    Examples
    --------
    >>> import numpy as np
    >>> from scipy.spatial.transform import Rotation
    >>> from study.guidance.frames import rigid
    >>> turns = Rotation.from_rotvec([[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0.2, -0.3, 0.1]])
    >>> poses = rigid(turns, [10.0, 0, 0] - turns.apply([0.0, 0, 150]))
    >>> bool(np.allclose(calibrate_pivot(poses).tip_tool, [0.0, 0, 150]))
    True
    """
    T = checked_transforms("T_ref_tool", T_ref_tool)
    R, p = T[:, :3, :3], T[:, :3, 3]
    spread = checked_spread("T_ref_tool", R, least_spread)
    tool, ref = solve_turned(R, -p)
    residuals = R @ tool + p - ref
    rows = equations(R)
    slope = np.einsum("nij,nik->jk", rows, rows)
    scores = np.einsum("nij,ni->nj", rows, residuals)
    return PivotCalibration(tool, ref, residuals, sandwich(slope, scores, 3, 6), spread)
