"""A patient who rests, is moved and rests again: what the filter of section 5.2 makes of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.filters import PatientFilter, PatientFilterSettings, PoseNoise, measured_noise
from study.guidance.frames import difference, rigid
from study.guidance.tracker import MarkerBody, Tracker, TrackerSettings, facing_pose

RAW, ADAPTIVE, HEAVY, LIGHT = "optical", "adaptive", "static weights only", "moving weights only"


@dataclass(frozen=True)
class PatientMotionSettings:
    """A marker on a patient who is moved once and stays where that led.

    Attributes
    ----------
    shift_mm, turn_deg : float
        Of the marker, along and about axes across the line of sight; a head that somebody leans on moves by
        1 to 10 mm.
    moving_s : float
        How long that takes; 0.3 to 3 s.
    rest_s : float
        Before and after; also of the recording from which noise is read.
    tracker : TrackerSettings
        Without distortion by default: it would move all signals alike.
    distance_mm, marker_mm : float
        From camera to marker; the marker's edge.

    Raises
    ------
    InputError
        If a number has no meaning.
    """

    shift_mm: float = 3.0
    turn_deg: float = 1.0
    moving_s: float = 1.0
    rest_s: float = 6.0
    tracker: TrackerSettings = field(default_factory=lambda: TrackerSettings(distortion_mm=0.0))
    distance_mm: float = 1500.0
    marker_mm: float = 80.0

    def __post_init__(self) -> None:
        for name in ("shift_mm", "turn_deg"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name}: expected a finite number, got {getattr(self, name)!r}")
        for name in ("moving_s", "distance_mm", "marker_mm"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise InputError(f"{name}: expected more than 0, got {value!r}")
        if not np.isfinite(self.rest_s) or self.rest_s < 2.0:
            raise InputError(f"rest_s: expected 2 s or more to read noise from, got {self.rest_s!r}")


@dataclass(frozen=True, eq=False)
class PatientRecord:
    """One run: what was measured, what filters made of it, what was true.

    Attributes
    ----------
    settings : PatientMotionSettings
    noise : PoseNoise
        Of the marker, read off a recording of its own at rest.
    thresholds : (2,) array
        mm and rad from the filtered pose beyond which the patient moves.
    time_s : (n,) array
        Of the tracker's exposures; its delay is the same for all and left out.
    truth : (n, 4, 4) array
        mm, camera axes from where the marker starts.
    signals : dict of str to (n, 4, 4) array
        Measured; filtered as set; with the weights of rest, and of motion, all the time.
    moving : (n,) bool array
        Whether the filter took the sample for motion.
    """

    settings: PatientMotionSettings
    noise: PoseNoise
    thresholds: np.ndarray
    time_s: np.ndarray
    truth: np.ndarray
    signals: dict[str, np.ndarray]
    moving: np.ndarray

    def table(self) -> pd.DataFrame:
        """A row a signal: noise while the patient rests, error while and for a second after he is moved.

        Noise is the root mean squared distance, and angle, from the mean; errors are against the pose at
        exposure. The first second, in which filters settle, is left out.
        """
        start = self.settings.rest_s
        rest = (self.time_s >= 1.0) & (self.time_s < start)
        moved = (self.time_s >= start) & (self.time_s < start + self.settings.moving_s + 1.0)
        rows = []
        for name, poses in self.signals.items():
            turned, shifted = difference(poses, self.truth)
            rows.append(
                {
                    "signal": name,
                    "noise_at_rest_mm": _spread(shifted[rest]),
                    "noise_at_rest_mrad": 1e3 * _spread(turned[rest]),
                    "rms_error_moving_mm": _rms(shifted[moved]),
                    "largest_error_moving_mm": float(np.linalg.norm(shifted[moved], axis=1).max()),
                    "rms_error_moving_mrad": 1e3 * _rms(turned[moved]),
                }
            )
        return pd.DataFrame(rows)


def _rms(vectors: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _spread(vectors: np.ndarray) -> float:
    return _rms(vectors - vectors.mean(axis=0))


def move_patient(
    settings: PatientMotionSettings | None = None,
    patient: PatientFilterSettings | None = None,
    rng: object = None,
) -> PatientRecord:
    """Move a patient once and filter what the tracker sees.

    Parameters
    ----------
    settings : PatientMotionSettings, optional
    patient : PatientFilterSettings, optional
    rng : anything `numpy.random.default_rng` takes

    Returns
    -------
    PatientRecord
    """
    settings = PatientMotionSettings() if settings is None else settings
    patient = PatientFilterSettings() if patient is None else patient
    rng = np.random.default_rng(rng)
    tracker = Tracker(settings.tracker, rng)
    time = np.arange(0.0, 2 * settings.rest_s + settings.moving_s, settings.tracker.cycle_s)
    share = np.clip((time - settings.rest_s) / settings.moving_s, 0.0, 1.0)
    way = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)  # starts and stops without a jerk
    turns = Rotation.from_euler("y", way[:, None] * settings.turn_deg, degrees=True)
    truth = rigid(turns, way[:, None] * [settings.shift_mm, 0.0, 0.0])
    still = np.tile(np.eye(4), (max(12, round(settings.rest_s / settings.tracker.cycle_s)), 1, 1))
    noise = measured_noise(_seen(settings, tracker, still, rng))
    measured = _seen(settings, tracker, truth, rng)

    signals, moving = {RAW: measured}, np.zeros(len(time), bool)
    for name, chosen in (
        (ADAPTIVE, patient),
        (HEAVY, _one_state(patient, patient.position_static, patient.orientation_static)),
        (LIGHT, _one_state(patient, patient.position_moving, patient.orientation_moving)),
    ):
        running = PatientFilter(chosen, noise)
        poses = np.empty_like(measured)
        for k, T in enumerate(measured):
            poses[k] = running.step(T)
            if name == ADAPTIVE:
                moving[k] = running.moving
        signals[name] = poses
    return PatientRecord(settings, noise, patient.thresholds(noise), time, truth, signals, moving)


def _one_state(patient: PatientFilterSettings, position: float, orientation: float) -> PatientFilterSettings:
    return replace(
        patient,
        position_static=position,
        position_moving=position,
        orientation_static=orientation,
        orientation_moving=orientation,
    )


def _seen(
    settings: PatientMotionSettings, tracker: Tracker, truth: np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """(n, 4, 4) measured poses, camera axes, from where the marker starts."""
    start = facing_pose([0.0, 0.0, settings.distance_mm])
    origin = rigid(translation=start[:3, 3])
    T_cam_pat = origin @ truth @ rigid(start[:3, :3])
    measured = tracker.measured(MarkerBody.plate(settings.marker_mm), T_cam_pat, rng)
    return np.linalg.inv(origin) @ measured @ rigid(start[:3, :3].T)
