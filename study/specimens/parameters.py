"""What a procedural temporal bone is made from: a few lengths in mm, each with its range among people."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from study.errors import InputError
from study.specimens.orientation import check_side

#: Range from which each parameter of a specimen is drawn, uniformly. All lengths are for size 1.
#: Chosen by us around three segmented bones of a public set and what anatomy books say of adults
#: (mastoid segment of the facial nerve 10 to 18 mm, ear canal 7 to 10 mm wide); no survey was fitted.
RANGES: dict[str, tuple[float, float]] = {
    "mastoid_depth": (20.0, 24.0),
    "mastoid_height": (21.0, 26.0),
    "cortex_thickness": (1.8, 3.4),
    "tegmen_height": (5.6, 7.8),
    "sinus_distance": (13.0, 16.5),
    "sinus_radius": (4.0, 5.2),
    "fossa_distance": (6.8, 9.0),
    "canal_radius": (3.4, 4.3),
    "canal_drop": (4.8, 8.4),
    "canal_lead": (3.2, 7.0),
    "nerve_radius": (0.8, 0.95),
    "nerve_slant": (-0.05, 0.22),
    "nerve_length": (11.0, 15.0),
    "pneumatisation": (0.40, 0.65),
    "cell_size": (2.2, 3.4),
    "otic_scale": (0.96, 1.04),
}


@dataclass(frozen=True)
class TemporalBoneParameters:
    """Lengths (mm) that shape a procedural temporal bone.

    The origin of its frame is the dome of the lateral semicircular canal, the most lateral point of
    the labyrinth and the landmark at the floor of the antrum. Defaults are the middle of `RANGES`.

    Parameters
    ----------
    side : {"right", "left"}
        A left bone is the mirror image of the right one with the same parameters and seed.
    size : float
        Scale of the mastoid (not a length): how far cortex, sinus, posterior fossa and tip lie from
        the antrum. The otic capsule, the ossicles and the nerves do not scale; they have adult size
        at birth, while the mastoid grows for years and differs most between people. 0.4 to 2.
    mastoid_depth : float
        From the dome to the lateral cortex.
    mastoid_height : float
        From the dome down to the tip of the mastoid process.
    cortex_thickness : float
        Of solid bone under the lateral surface.
    tegmen_height : float
        From the dome up to the floor of the middle cranial fossa.
    sinus_distance : float
        From the dome back to the front wall of the sigmoid sinus.
    sinus_radius : float
        Of the sigmoid sinus.
    fossa_distance : float
        From the dome back to the dura of the posterior fossa.
    canal_radius : float
        Of the bony external auditory canal.
    canal_drop, canal_lead : float
        From the dome down, and forward, to the axis of the external auditory canal.
    nerve_radius : float
        Of the facial nerve's canal.
    nerve_slant : float
        mm by which the nerve's mastoid segment runs outwards per mm down.
    nerve_length : float
        Of the mastoid segment, second genu to stylomastoid foramen.
    pneumatisation : float
        Share of the mastoid inside its cortex that is air, 0 to 0.8.
    cell_size : float
        Typical distance across an air cell.
    otic_scale : float
        Scale of labyrinth, inner canal and ossicles.

    Raises
    ------
    InputError
        If a value is not positive (nerve_slant and pneumatisation may be 0) or beyond anatomy.
    """

    side: str = "right"
    size: float = 1.0
    mastoid_depth: float = 22.0
    mastoid_height: float = 23.5
    cortex_thickness: float = 2.6
    tegmen_height: float = 6.7
    sinus_distance: float = 14.75
    sinus_radius: float = 4.6
    fossa_distance: float = 7.9
    canal_radius: float = 3.85
    canal_drop: float = 6.6
    canal_lead: float = 5.1
    nerve_radius: float = 0.875
    nerve_slant: float = 0.085
    nerve_length: float = 13.0
    pneumatisation: float = 0.525
    cell_size: float = 2.8
    otic_scale: float = 1.0

    def __post_init__(self) -> None:
        check_side(self.side)
        if not 0.4 <= self.size <= 2.0:
            raise InputError(f"size: expected 0.4 to 2, got {self.size}")
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            # Twice the range to either side is still a bone; beyond, structures cross each other.
            slack = 2 * (high - low)
            low, high = max(low - slack, 0.0 if name != "nerve_slant" else -np.inf), high + slack
            if name == "pneumatisation":
                low, high = 0.0, 0.8
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low:g} to {high:g}, got {value}")

    @classmethod
    def drawn(cls, rng, side: str = "right", size: float = 1.0) -> TemporalBoneParameters:
        """Parameters drawn from `RANGES`, all but side and size.

        Parameters
        ----------
        rng : anything `numpy.random.default_rng` takes
        side, size
            See the class.
        """
        rng = np.random.default_rng(rng)
        values = {name: float(rng.uniform(low, high)) for name, (low, high) in RANGES.items()}
        return cls(side=side, size=size, **values)

    def scaled(self, size: float) -> TemporalBoneParameters:
        """The same bone with another size."""
        return replace(self, size=float(size))


assert {f.name for f in fields(TemporalBoneParameters)} == {"side", "size", *RANGES}
