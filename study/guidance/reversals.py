"""Figure 7 as a virtual experiment: an arm that goes to and fro, seen late by a tracker, early by encoders.

What reaches the filters follows from causes: spheres that jitter, a pose fitted to them, a tip away from the
marker, frames that come late and are held, encoders of limited resolution that come a cycle late, an arm
that moves a little more than it tells.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from study.errors import InputError
from study.guidance.filters import PoseNoise, measured_noise
from study.guidance.frames import rigid
from study.guidance.tracker import MarkerBody, Tracker, TrackerSettings, facing_pose

#: Between the times at which the motion is known; everything else looks at it in between.
_GRID_S = 0.001


@dataclass(frozen=True)
class ReversalSettings:
    """One axis of an arm that goes to and fro between rests, and what watches it.

    Attributes
    ----------
    speed_mm_s : float
        Between reversals; an arm that positions a drill moves at 20 to 60.
    acceleration_mm_s2 : float
        While it turns back; 100 to 1000 for a small arm at such speeds.
    smoothing_s : float
        Over which the acceleration itself sets in; 0.02 to 0.1.
    stroke_mm : float
        To and fro; at most what the speed makes of it, at least a turn.
    strokes : int
    rest_s : float
        Before the first stroke and after the last, and of the recording from which noise is read.
    tracker : TrackerSettings
        Printed: 25 Hz, 40 ms. Without distortion by default: it would move all signals alike, and slowly.
    tracker_phase_s : float
        Of the tracker's exposures against the filter's steps. Two devices of which nobody makes one wait
        for the other may have any, up to a cycle.
    distance_mm, marker_mm, lever_mm : float
        From camera to marker; the marker's edge; from the marker to the tip, across the line of sight.
    sample_s : float
        Of the filters; printed.
    robot_cycle_s, encoder_delay_s : float
        Printed: 12 ms each (3.1 and 5.3).
    encoder_step_mm : float
        Of the position told by the encoders; 0.001 to 0.01.
    gain_error : float
        Share by which the arm moves more than it tells: kinematics that nobody calibrated; up to 0.01.

    Raises
    ------
    InputError
        If a number has no meaning, or the stroke is too short to reach the speed.
    """

    speed_mm_s: float = 40.0
    acceleration_mm_s2: float = 200.0
    smoothing_s: float = 0.04
    stroke_mm: float = 40.0
    strokes: int = 6
    rest_s: float = 6.0
    tracker: TrackerSettings = field(default_factory=lambda: TrackerSettings(distortion_mm=0.0))
    tracker_phase_s: float = 0.0
    distance_mm: float = 1500.0
    marker_mm: float = 80.0
    lever_mm: float = 180.0
    sample_s: float = 0.02
    robot_cycle_s: float = 0.012
    encoder_delay_s: float = 0.012
    encoder_step_mm: float = 0.005
    gain_error: float = 0.005

    def __post_init__(self) -> None:
        positive = ("speed_mm_s", "acceleration_mm_s2", "stroke_mm", "rest_s", "distance_mm", "marker_mm")
        for name in (*positive, "sample_s", "robot_cycle_s"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise InputError(f"{name}: expected more than 0, got {value!r}")
        for name in ("smoothing_s", "tracker_phase_s", "lever_mm", "encoder_delay_s", "encoder_step_mm"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise InputError(f"{name}: expected at least 0, got {value!r}")
        if not np.isfinite(self.gain_error) or abs(self.gain_error) >= 1:
            raise InputError(f"gain_error: expected a share between -1 and 1, got {self.gain_error!r}")
        if isinstance(self.strokes, bool) or self.strokes != int(self.strokes) or self.strokes < 1:
            raise InputError(f"strokes: expected a whole number of at least 1, got {self.strokes!r}")
        if self.rest_s < 2.0:
            raise InputError(f"rest_s: expected 2 s or more to read noise from, got {self.rest_s!r}")
        shortest = self.speed_mm_s**2 / self.acceleration_mm_s2
        if self.stroke_mm < shortest:
            raise InputError(
                f"stroke_mm: expected {shortest:g} mm or more to reach {self.speed_mm_s:g} mm/s at "
                f"{self.acceleration_mm_s2:g} mm/s^2, got {self.stroke_mm:g}"
            )

    @property
    def stroke_s(self) -> float:
        """How long a stroke takes, from standing to standing."""
        return self.stroke_mm / self.speed_mm_s + self.speed_mm_s / self.acceleration_mm_s2

    @property
    def moving_s(self) -> tuple[float, float]:
        """When the arm starts and when it has stopped."""
        return self.rest_s, self.rest_s + self.strokes * self.stroke_s + self.smoothing_s


class Motion:
    """Where the arm truly is: strokes at constant speed with smooth turns between them."""

    def __init__(self, settings: ReversalSettings) -> None:
        end = settings.moving_s[1] + settings.rest_s
        self._times = np.arange(0.0, end + 1.0, _GRID_S)
        since = self._times - settings.rest_s
        stroke = np.floor(since / settings.stroke_s)
        within = since - stroke * settings.stroke_s
        speed = settings.acceleration_mm_s2 * np.minimum(within, settings.stroke_s - within)
        speed = np.clip(speed, 0.0, settings.speed_mm_s)
        moving = (stroke >= 0) & (stroke < settings.strokes)
        velocity = np.where(moving, np.where(stroke % 2 == 0, speed, -speed), 0.0)
        # Each value is the mean of those before, so that nothing moves earlier than it is said to.
        window = max(1, round(settings.smoothing_s / _GRID_S))
        sums = np.concatenate([np.zeros(window), np.cumsum(velocity)])
        self._velocities = (sums[window:] - sums[:-window]) / window
        middle = 0.5 * (self._velocities[1:] + self._velocities[:-1]) * _GRID_S
        self._positions = np.concatenate([[0.0], np.cumsum(middle)])

    def position(self, times: np.ndarray) -> np.ndarray:
        """mm; before the first time at rest."""
        return np.interp(times, self._times, self._positions)

    def velocity(self, times: np.ndarray) -> np.ndarray:
        """mm/s."""
        return np.interp(times, self._times, self._velocities)


@dataclass(frozen=True, eq=False)
class ReversalRecord:
    """What the filters got, step by step, and what was true.

    Attributes
    ----------
    settings : ReversalSettings
    time_s : (n,) array
        Of the filters' steps.
    tip : (n, 4, 4) array
        Latest pose of the tip that the tracker had delivered, camera axes from where it starts; it moves
        along x. mm.
    fresh : (n,) bool array
        Whether it was delivered since the step before.
    velocity : (n, 6) array
        From the encoders, mm/s then rad/s.
    noise : PoseNoise
        Of the tip's pose, read off another recording of the arm at rest.
    """

    settings: ReversalSettings
    time_s: np.ndarray
    tip: np.ndarray
    fresh: np.ndarray
    velocity: np.ndarray
    noise: PoseNoise

    @cached_property
    def motion(self) -> Motion:
        """The true one."""
        return Motion(self.settings)

    @property
    def truth_mm(self) -> np.ndarray:
        """(n,) true position."""
        return self.motion.position(self.time_s)

    @property
    def raw_mm(self) -> np.ndarray:
        """(n,) position as the tracker has it, held between its frames."""
        return self.tip[:, 0, 3]

    @property
    def moving(self) -> np.ndarray:
        """(n,) bool: while the arm moves."""
        start, stop = self.settings.moving_s
        return (self.time_s >= start) & (self.time_s <= stop)

    @property
    def at_rest(self) -> np.ndarray:
        """(n,) bool: before the arm moves, without the first second in which filters settle."""
        return (self.time_s >= 1.0) & (self.time_s < self.settings.rest_s)


def record_reversals(settings: ReversalSettings | None = None, rng: object = None) -> ReversalRecord:
    """Run the arm to and fro, once.

    Parameters
    ----------
    settings : ReversalSettings, optional
    rng : anything `numpy.random.default_rng` takes

    Returns
    -------
    ReversalRecord
    """
    settings = ReversalSettings() if settings is None else settings
    rng = np.random.default_rng(rng)
    motion = Motion(settings)
    tracker = Tracker(settings.tracker, rng)
    cycle = settings.tracker.cycle_s
    resting = _seen(settings, tracker, np.zeros(max(12, round(settings.rest_s / cycle))), rng)

    # A little later than on the dot, so that what is due at a step is there in spite of rounding.
    just = 1e-6
    time = np.arange(0.0, settings.moving_s[1] + settings.rest_s, settings.sample_s)
    latest = np.floor((time + just - settings.tracker_phase_s - settings.tracker.delay_s) / cycle).astype(int)
    exposures = np.arange(latest[0], latest[-1] + 1)
    poses = _seen(settings, tracker, motion.position(exposures * cycle + settings.tracker_phase_s), rng)

    reading = np.floor((time + just - settings.encoder_delay_s) / settings.robot_cycle_s)
    told = [
        _stepped(motion.position(n * settings.robot_cycle_s) / (1.0 + settings.gain_error), settings)
        for n in (reading, reading - 1)
    ]
    velocity = np.zeros((len(time), 6))
    velocity[:, 0] = (told[0] - told[1]) / settings.robot_cycle_s
    return ReversalRecord(
        settings=settings,
        time_s=time,
        tip=poses[latest - latest[0]],
        fresh=np.diff(latest, prepend=latest[0] - 1) > 0,
        velocity=velocity,
        noise=measured_noise(resting),
    )


def _seen(settings: ReversalSettings, tracker: Tracker, along: np.ndarray, rng: object) -> np.ndarray:
    """(n, 4, 4) measured poses of the tip, camera axes, for (n,) positions along x from where it starts."""
    start = facing_pose([0.0, 0.0, settings.distance_mm])
    T_tool_tcp = rigid(translation=[0.0, -settings.lever_mm, 0.0])
    T = np.tile(start, (len(along), 1, 1))
    T[:, 0, 3] += along
    tip = tracker.measured(MarkerBody.plate(settings.marker_mm), T, rng) @ T_tool_tcp
    tip[:, :3, 3] -= (start @ T_tool_tcp)[:3, 3]
    return tip


def _stepped(position: np.ndarray, settings: ReversalSettings) -> np.ndarray:
    step = settings.encoder_step_mm
    return np.round(position / step) * step if step > 0 else position
