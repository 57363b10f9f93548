"""What the compiled steps of the fusion write to on their way."""

from __future__ import annotations

import numpy as np


def workspace(lags: int) -> np.ndarray:
    """(5, max(lags + 2, 4)) array for `fuse_position` and `fuse_orientation`; its content does not matter."""
    return np.zeros((5, max(lags + 2, 4)))
