"""What a procedural kidney is made from: lengths in mm and angles, each with its range among people."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError
from study.specimens.orientation import check_side

#: Range from which the shape of a named kidney is drawn, uniformly. Chosen by us around what anatomy
#: books say of adults (10 to 12 cm long, 5 to 7 cm wide, 3 to 5 cm thick, the upper pole tilted
#: medially and backwards, the hilum facing forwards by about 30 degrees) and four segmented ones of a
#: public set; no survey was fitted.
RANGES: dict[str, tuple[float, float]] = {
    "length": (106.0, 120.0),
    "width": (58.0, 66.0),
    "thickness": (43.0, 50.0),
    "bend": (15.0, 22.0),
    "upper_pole": (-0.06, 0.14),
    "sinus_length": (29.0, 37.0),
    "sinus_depth": (18.0, 23.0),
    "sinus_width": (10.0, 13.0),
    "lobe_height": (1.2, 1.7),
    "medial_tilt_deg": (6.0, 20.0),
    "posterior_tilt_deg": (15.0, 32.0),
    "hilum_turn_deg": (22.0, 36.0),
}

_TUMOUR_RANGES = {
    "tumour_diameter": (8.0, 40.0),
    "tumour_depth": (-20.0, 30.0),
    "tumour_height": (-0.9, 0.9),
    "tumour_angle_deg": (-180.0, 180.0),
    "tumour_lobe_height": (0.0, 2.0),
}


@dataclass(frozen=True)
class KidneyParameters:
    """Lengths (mm) and angles that shape a procedural kidney with one tumour.

    Parameters
    ----------
    side : {"right", "left"}
        A left kidney is the mirror image of the right one with the same parameters and seed.
    length, width, thickness : float
        Of the bean without its lobes: from pole to pole, from hilum to convex border, from front to back.
    bend : float
        By which the poles lie nearer to the spine than the middle.
    upper_pole : float
        By which share the upper pole is stouter than the middle, and the lower one slimmer; not a length.
    sinus_length, sinus_depth, sinus_width : float
        Of the renal sinus, which opens at the hilum: along the kidney, into it, from front to back.
    lobe_height : float
        Standard deviation of the height of the lobes on the surface.
    medial_tilt_deg, posterior_tilt_deg : float
        Of the long axis: its upper end leans to the spine and backwards.
    hilum_turn_deg : float
        By which the hilum faces forwards rather than to the spine.
    tumour_diameter : float
        At most 40 mm, where small renal masses end (Siebold, 4.1).
    tumour_depth : float
        From the smooth capsule down to the tumour's centre; negative outside. It decides how much of
        the tumour is exophytic.
    tumour_height : float
        Where along the long axis, -1 (lower pole) to 1 (upper pole); not a length.
    tumour_angle_deg : float
        Where around the long axis: 0 on the convex border, 90 behind, -90 in front, 180 at the hilum.
    tumour_lobe_height : float
        Standard deviation of the height of the lobes on the tumour.

    Raises
    ------
    InputError
        If a value is not finite or beyond anatomy.
    """

    side: str = "right"
    length: float = 113.0
    width: float = 62.0
    thickness: float = 46.5
    bend: float = 18.5
    upper_pole: float = 0.06
    sinus_length: float = 33.0
    sinus_depth: float = 20.5
    sinus_width: float = 11.5
    lobe_height: float = 1.45
    medial_tilt_deg: float = 13.0
    posterior_tilt_deg: float = 23.5
    hilum_turn_deg: float = 29.0
    tumour_diameter: float = 28.0
    tumour_depth: float = 0.0
    tumour_height: float = 0.4
    tumour_angle_deg: float = -30.0
    tumour_lobe_height: float = 1.0

    def __post_init__(self) -> None:
        check_side(self.side)
        for name, (low, high) in {**RANGES, **_TUMOUR_RANGES}.items():
            value = getattr(self, name)
            if name in RANGES:
                # The range once more to either side is still a kidney.
                slack = high - low
                low, high = max(low - slack, 0.0 if low >= 0 else -np.inf), high + slack
            if not low <= value <= high:
                raise InputError(f"{name}: expected {low:g} to {high:g}, got {value}")

    @classmethod
    def drawn(cls, rng, side: str = "right", **tumour: float) -> KidneyParameters:
        """Parameters of the kidney drawn from `RANGES`; those of the tumour as given.

        Parameters
        ----------
        rng : anything `numpy.random.default_rng` takes
        side : {"right", "left"}
        **tumour : float
            ``tumour_diameter`` and so on, see the class.
        """
        rng = np.random.default_rng(rng)
        values = {name: float(rng.uniform(low, high)) for name, (low, high) in RANGES.items()}
        return cls(side=side, **{**values, **tumour})
