"""Other laws between bone removed and speed, to see what hangs on the one that was taken.

The text prints the limits of the speed and that it follows from the bone removed per step, but no law
(Siebold, 2.4.1). Each law here has the same one constant as `FeedSettings`, fitted in the same way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.robots.feed import FeedSettings


def _per_mm(removed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    removed, lengths = np.asarray(removed, dtype=float), np.asarray(lengths, dtype=float)
    return np.divide(removed, lengths, out=np.zeros(removed.shape), where=lengths > 0)


@dataclass(frozen=True)
class LinearFeed(FeedSettings):
    """Speed falls in proportion to the bone removed per mm: ``max_speed`` in air, ``min_speed`` at most.

    At ``removal_rate / min_speed`` mm^3 a mm the least speed is reached, as under `FeedSettings`.
    """

    def speeds(self, removed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """(m,) mm/s; see `FeedSettings.speeds`."""
        share = _per_mm(removed, lengths) * self.min_speed / self.removal_rate
        return np.clip(self.max_speed - (self.max_speed - self.min_speed) * share, self.min_speed, None)


@dataclass(frozen=True)
class SmoothFeed(FeedSettings):
    """Speed falls from one limit towards the other without reaching it.

    Half way at ``removal_rate / max_speed`` mm^3 a mm, where `FeedSettings` begins to slow down.
    """

    def speeds(self, removed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """(m,) mm/s; see `FeedSettings.speeds`."""
        load = _per_mm(removed, lengths) * self.max_speed / self.removal_rate
        return self.min_speed + (self.max_speed - self.min_speed) / (1 + load)


@dataclass(frozen=True)
class ContactFeed(FeedSettings):
    """One speed in air and one in bone, however much is removed: the law that favours few, heavy steps most.

    In bone the burr moves as fast as `FeedSettings` lets it at 1 mm^3 a mm.
    """

    def speeds(self, removed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """(m,) mm/s; see `FeedSettings.speeds`."""
        in_bone = np.clip(self.removal_rate, self.min_speed, self.max_speed)
        return np.where(_per_mm(removed, lengths) > 0, in_bone, self.max_speed)


#: Every law by name, the one taken first.
LAWS = {
    "removal rate": FeedSettings,
    "linear": LinearFeed,
    "smooth": SmoothFeed,
    "contact only": ContactFeed,
}
