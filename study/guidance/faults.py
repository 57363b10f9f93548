"""What can go wrong while a hole is drilled, as times at which it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from study.errors import InputError

#: Markers in the order of the loop's pictures.
MARKERS = ("tool", "base", "patient")
#: What tells one fault of each kind.
_PARTS = {
    "occluded": ("marker", "from", "to"),
    "frozen": ("from", "to"),
    "silent": ("from", "to"),
    "spikes": ("time", "shift"),
    "patient_moves": ("from", "to", "shift"),
    "no_handshake": ("from", "to"),
}


@dataclass(frozen=True)
class Faults:
    """Faults of tracker, link and patient; times in s since the start, intervals as (from, to).

    Attributes
    ----------
    occluded : sequence of (marker, from, to)
        ``"tool"``, ``"base"`` or ``"patient"`` out of sight.
    frozen : sequence of (from, to)
        The tracker delivers its last picture again and again.
    silent : sequence of (from, to)
        It delivers nothing.
    spikes : sequence of (time, (3,) mm)
        One picture has the drill's marker elsewhere, in the camera's axes.
    patient_moves : sequence of (from, to, (3,) mm)
        The patient moves by as much, evenly in that time, in the robot's axes; a jump when the times agree.
    no_handshake : sequence of (from, to)
        The robot's control box hears nothing.

    Raises
    ------
    InputError
        If a fault is not told by what it should be, a marker is unknown, a time is not finite or negative, or
        an interval ends before it begins.
    """

    occluded: Sequence[tuple[str, float, float]] = ()
    frozen: Sequence[tuple[float, float]] = ()
    silent: Sequence[tuple[float, float]] = ()
    spikes: Sequence[tuple[float, Sequence[float]]] = ()
    patient_moves: Sequence[tuple[float, float, Sequence[float]]] = ()
    no_handshake: Sequence[tuple[float, float]] = ()

    def __post_init__(self) -> None:
        for name, parts in _PARTS.items():
            for one in getattr(self, name):
                if not hasattr(one, "__len__") or len(one) != len(parts):
                    raise InputError(f"{name}: expected ({', '.join(parts)}), got {one!r}")
        for marker, *_ in self.occluded:
            if marker not in MARKERS:
                raise InputError(f"occluded: expected one of {', '.join(MARKERS)}, got {marker!r}")
        intervals = [(a, b) for _, a, b in self.occluded] + [(a, b) for a, b, _ in self.patient_moves]
        intervals += [
            *self.frozen,
            *self.silent,
            *self.no_handshake,
            *((time, time) for time, _ in self.spikes),
        ]
        for begin, end in intervals:
            if not (np.isfinite([begin, end]).all() and 0 <= begin <= end):
                raise InputError(f"expected 0 <= from <= to, in s, got {begin!r} to {end!r}")
        for vector in [v for _, v in self.spikes] + [v for *_, v in self.patient_moves]:
            if np.shape(vector) != (3,) or not np.isfinite(vector).all():
                raise InputError(f"expected a shift of three finite numbers in mm, got {vector!r}")

    def over(
        self, pictures: int, picture_s: float, commands: int, command_s: float
    ) -> tuple[np.ndarray, ...]:
        """What the loop reads of them, picture by picture and command by command.

        Returns
        -------
        tuple
            Spikes (pictures, 3) mm, seen (pictures, 3) bool, frozen (pictures,) int, shift of the patient
            (pictures, 3) mm, handshake (commands,) bool.
        """
        times = np.arange(pictures) * picture_s
        seen = np.ones((pictures, 3), bool)
        for marker, begin, end in self.occluded:
            seen[(times >= begin) & (times <= end), MARKERS.index(marker)] = False
        frozen = np.zeros(pictures, np.int64)
        for kind, intervals in ((1, self.frozen), (2, self.silent)):
            for begin, end in intervals:
                frozen[(times >= begin) & (times <= end)] = kind
        spikes = np.zeros((pictures, 3))
        for time, vector in self.spikes:
            spikes[min(pictures - 1, round(time / picture_s))] += vector
        shift = np.zeros((pictures, 3))
        for begin, end, vector in self.patient_moves:
            share = np.clip((times - begin) / (end - begin), 0, 1) if end > begin else (times >= begin) * 1.0
            shift += share[:, None] * np.asarray(vector, dtype=float)
        at = np.arange(commands) * command_s
        handshake = np.ones(commands, bool)
        for begin, end in self.no_handshake:
            handshake[(at >= begin) & (at <= end)] = False
        return spikes, seen, frozen, shift, handshake
