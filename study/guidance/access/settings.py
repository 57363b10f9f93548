"""What a drill to the cochlea may touch, and how its line is looked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from numbers import Integral

import numpy as np

from study.errors import InputError
from study.margins.settings import ACCEPTABLE_RISKS as PRINTED_RISKS
from study.specimens.structures import SYNONYMS

#: Probability that is accepted for each structure to be touched.
#:
#: Those of facial nerve, chorda tympani, inner canal, sigmoid sinus and ear canal are Siebold's (3.3.1), from
#: the same group and for the same bone; from memory, and not checked against it, Noble's later paper on drill
#: paths takes the same 0.1 % and 5 % for the two nerves. The others are ours: what leads to death or stroke
#: (carotid, brain) as the facial nerve; what opens the inner ear beyond the cochlea, breaks the chain of the
#: ossicles or leaks (dura) as the sinus, 1 %. An ear that gets an implant has little hearing left to lose.
ACCEPTABLE_PROBABILITIES = {
    **PRINTED_RISKS,
    "labyrinth": 0.01,
    "ossicles": 0.01,
    "dura": 0.01,
    "intracranial": 0.001,
    "carotid_artery": 0.001,
    "vestibular_aqueduct": 0.01,
    "temporomandibular_joint": 0.05,
}

VOXELS = ("centre", "whole")


@dataclass(frozen=True)
class AccessSettings:
    """Settings of `plan_access`.

    Parameters
    ----------
    drill_diameter : float
        mm. 1.5 passes a facial recess of 2 mm (Baron, 2.1); an electrode asks for about as much.
    acceptable : mapping of str to float
        Structure -> probability of being touched that is accepted. Also its weight: the damage that is
        expected of a line is the sum of probability over accepted probability, so that a chorda at 5 %
        weighs as much as a facial nerve at 0.1 %. Structures without an entry may be drilled.
    sacrificed : tuple of str
        Structures that may be touched if nothing else helps: they block no line and violate no limit, but
        keep their weight. Some surgeons take the chorda tympani for a way to the cochlea.
    voxels : {"centre", "whole"}
        When a voxel is touched, see `study.guidance.access.collision`.
    below_oval_window : float
        mm. The target is the labyrinth's nearest point to the oval window that lies at least so far below
        it. The round window lies there, about 2 mm from the oval one (from memory, unverified).
    opening : float
        mm around the target within which the labyrinth is the cochlea's wall that is to be opened. The rest
        (vestibule, canals, further turns) is to be spared. Below `below_oval_window` or equal to it, so that
        the oval window is not a part of it.
    fan_deg : float
        Half the opening angle of the cone of directions that are looked at, about straight lateral.
    step_deg, fine_step_deg : float
        Between directions, of the whole cone and around its best ones.
    recess_gap, recess_angle_deg : float
        mm and degrees. A line passes through the facial recess when the nearest points of facial nerve and
        chorda tympani lie no farther apart along it, and on opposite sides of it, by at least that angle.
        The two form a V: inside, a line sees them under 180 degrees less the V's own angle; below its
        corner, where the chorda leaves the nerve, under less than 90.
    refined, simulated : int
        Directions around which finer ones are tried; lines whose errors are simulated.
    samples : int
        Errors drawn for each of those.

    Raises
    ------
    InputError
        If a value cannot be.
    """

    drill_diameter: float = 1.5
    acceptable: Mapping[str, float] = field(default_factory=lambda: dict(ACCEPTABLE_PROBABILITIES))
    sacrificed: tuple[str, ...] = ()
    voxels: str = "centre"
    below_oval_window: float = 2.0
    opening: float = 2.0
    fan_deg: float = 60.0
    step_deg: float = 2.0
    fine_step_deg: float = 0.5
    recess_gap: float = 5.0
    recess_angle_deg: float = 120.0
    refined: int = 4
    simulated: int = 12
    samples: int = 10_000

    def __post_init__(self) -> None:
        for name in ("drill_diameter", "opening", "recess_gap", "step_deg", "fine_step_deg"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name}: expected a number above 0, got {getattr(self, name)}")
        if not (np.isfinite(self.below_oval_window) and self.below_oval_window >= self.opening):
            raise InputError(
                f"below_oval_window: expected at least opening ({self.opening} mm), "
                f"got {self.below_oval_window}"
            )
        if not 0 < self.fan_deg <= 85:
            raise InputError(f"fan_deg: expected above 0 and at most 85 degrees, got {self.fan_deg}")
        if not 90 <= self.recess_angle_deg < 180:
            raise InputError(f"recess_angle_deg: expected 90 to below 180, got {self.recess_angle_deg}")
        if self.voxels not in VOXELS:
            raise InputError(f"voxels: expected one of {VOXELS}, got {self.voxels!r}")
        for name in ("refined", "simulated", "samples"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Integral) or value < 1:
                raise InputError(f"{name}: expected a whole number of at least 1, got {value!r}")
        for name, value in self.acceptable.items():
            if name not in SYNONYMS or name in ("air", "air_cells", "bone", "middle_ear"):
                raise InputError(f"acceptable: expected structures of {sorted(SYNONYMS)}, got {name!r}")
            if not 0 < value < 1:
                raise InputError(f"acceptable: expected a share between 0 and 1 for {name!r}, got {value}")
        for name in ("facial_nerve", "labyrinth"):
            if name not in self.acceptable:
                raise InputError(f"acceptable: expected a probability for {name!r}, got none")
        wrong = [name for name in self.sacrificed if name not in self.acceptable or name == "facial_nerve"]
        if wrong:
            raise InputError(
                f"sacrificed: expected structures of {sorted(set(self.acceptable) - {'facial_nerve'})}, "
                f"got {wrong}"
            )

    @property
    def drill_radius(self) -> float:
        """Half the diameter, mm."""
        return self.drill_diameter / 2
