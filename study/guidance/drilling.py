"""Drill holes with the whole loop running: arm, tracker, filters, fusion, control, guards and a bending bit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import gcd

import numpy as np
from scipy import stats
from scipy.signal import lfilter

from study.errors import GuidanceError, InputError
from study.guidance.control import ControlSettings
from study.guidance.faults import Faults
from study.guidance.frames import difference, inverse, moved, quaternions, rigid
from study.guidance.loop import _kernels
from study.guidance.loop.records import Inputs, State, Workspace
from study.guidance.safety import SafetySettings, Status
from study.guidance.scene import facing_orientation
from study.guidance.setting_up import SetUp
from study.registration.first_order import cross_matrices
from study.robots.arms import ArmErrors, SixAxisArm, arm, differential_gain

#: A repeatability is printed as mean plus three standard deviations of a 3-D distance (ISO 9283): with
#: normal errors so many of an axis' standard deviations.
REPEATABILITY_STDS = float(np.sqrt(8.0 / np.pi) + 3.0 * np.sqrt(3.0 - 8.0 / np.pi))


@dataclass(frozen=True)
class LoopSettings:
    """How the robot is run: filters, fusion, control, guards, and the operator's habits.

    Attributes
    ----------
    control : ControlSettings
    safety : SafetySettings
    sample_s : float
        Of the fusion; printed: 0.02 s (section 5.3).
    static_weight, moving_weight, static_turn_weight, moving_turn_weight : float
        Weight of the new sample in the patient's filter (section 5.2).
    moving_stds : float
        Multiple of the measured noise beyond which the patient counts as moving.
    position_process_mm, velocity_process_mm_s, rotation_process_rad, spin_process_rad_s : float
        Standard deviations that the fusion's model gains in a step.
    velocity_std_mm_s, spin_std_rad_s : float
        Of the velocity by the encoders.
    gate : float
        Chance of refusing a right sample of the tracker; 0 refuses none.
    approach_mm : float
        Distance outside of the entry where the drill finds its line.
    wait_mm : float
        The operator goes on only while the tip is seen this close to its line.
    settle_s, stay_s : float
        On the line before going on, and at the end before coming back.
    retraction : float
        Speed of coming back over that of insertion.
    wander_s : float
        Over which the arm's repeatability error changes.
    """

    control: ControlSettings = field(default_factory=ControlSettings)
    safety: SafetySettings = field(default_factory=SafetySettings)
    sample_s: float = 0.02
    static_weight: float = 0.1
    moving_weight: float = 0.95
    static_turn_weight: float = 0.05
    moving_turn_weight: float = 0.9
    moving_stds: float = 5.0
    position_process_mm: float = 0.005
    velocity_process_mm_s: float = 1.0
    rotation_process_rad: float = 2e-5
    spin_process_rad_s: float = 5e-3
    velocity_std_mm_s: float = 0.05
    spin_std_rad_s: float = 2e-4
    gate: float = 1e-6
    approach_mm: float = 10.0
    wait_mm: float = 0.3
    settle_s: float = 2.0
    stay_s: float = 1.0
    retraction: float = 4.0
    wander_s: float = 2.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in ("control", "safety"):
                continue
            if (
                not np.isfinite(value)
                or value < 0
                or (value == 0 and name not in ("gate", "settle_s", "stay_s"))
            ):
                raise InputError(f"{name}: expected a finite number above 0, got {value!r}")
        for name in ("static_weight", "moving_weight", "static_turn_weight", "moving_turn_weight", "gate"):
            if getattr(self, name) > 1:
                raise InputError(f"{name}: expected at most 1, got {getattr(self, name)!r}")


@dataclass(frozen=True, eq=False)
class DrilledHole:
    """One hole: the log of the loop, and what was left in the material.

    Attributes
    ----------
    entry, direction : (3,) arrays
        Of the planned line, image frame, mm.
    length, beyond : float
        From entry to target, and how far the tip was to go on, mm.
    time_s : (n,) array
    tip : (n, 3) array
        True tip of a bit that does not bend, image frame, mm.
    axis : (n, 3) array
        From the drill's body to the tip.
    bent : (n, 3) array
        By how much the bit's tip is bent, mm.
    depth : (n,) array
        Desired tip beyond the entry, mm.
    seen_across : (n,) array
        Distance from the line that the robot believes, mm.
    status : (n,) array of int
        See `Status`.
    phase : (n,) array of int
        0 finds the line, 1 inserts, 2 stays, 3 comes back.
    """

    entry: np.ndarray
    direction: np.ndarray
    length: float
    beyond: float
    time_s: np.ndarray
    tip: np.ndarray
    axis: np.ndarray
    bent: np.ndarray
    depth: np.ndarray
    seen_across: np.ndarray
    status: np.ndarray
    phase: np.ndarray

    @property
    def end(self) -> Status:
        """How it ended."""
        return Status(int(self.status[-1]))

    @property
    def along(self) -> np.ndarray:
        """(n,) true tip beyond the entry, mm."""
        return (self.tip - self.entry) @ self.direction

    @property
    def across(self) -> np.ndarray:
        """(n,) true distance of the tip, bent as it is, from the planned line, mm."""
        off = self.tip + self.bent - self.entry
        return np.linalg.norm(off - (off @ self.direction)[:, None] * self.direction, axis=1)

    def centre(self, depth: float, burr_mm: float = 8.0) -> np.ndarray:
        """(3,) centre of the hole in the plane across the planned line at a depth, image frame, mm.

        The mean over the time in which the cutting part of the burr went through the plane on its way in.

        Parameters
        ----------
        depth : float
            Beyond the entry, mm.
        burr_mm : float
            Length of the cutting part.

        Raises
        ------
        GuidanceError
            If the drill did not come that deep.
        """
        past = self.along - depth
        rows = (self.phase <= 2) & (past >= 0) & (past <= burr_mm)
        if not rows.any():
            raise GuidanceError(
                f"centre: the drill did not reach {depth:.3g} mm; it ended as {self.end.name}"
            )
        share = past[rows] / (self.axis[rows] @ self.direction)
        middle = self.tip[rows] + self.bent[rows] - share[:, None] * self.axis[rows]
        return middle.mean(axis=0)

    def error_at(self, depth: float) -> np.ndarray:
        """(3,) centre of the hole minus the planned line at a depth, image frame, mm."""
        return self.centre(depth) - (self.entry + depth * self.direction)

    @property
    def bottom(self) -> np.ndarray:
        """(3,) where the tip stayed at the end of the hole, image frame, mm.

        Raises
        ------
        GuidanceError
            If it did not come to the end.
        """
        rows = self.phase == 2
        if not rows.any():
            raise GuidanceError(f"bottom: the drill did not reach the end; it ended as {self.end.name}")
        return (self.tip[rows] + self.bent[rows]).mean(axis=0)


class HoleRun:
    """One hole being drilled; it can be stopped by its guards, and told to go on.

    Parameters
    ----------
    ready : SetUp
    hole : int
        Number of the phantom's hole.
    rng : anything `numpy.random.default_rng` takes
    settings : LoopSettings, optional
    faults : Faults, optional
        What goes wrong on the way.
    built : SixAxisArm, optional
        The arm as built; drawn when not given.

    Raises
    ------
    ReachError
        If the arm cannot take a pose of the hole.
    """

    def __init__(
        self,
        ready: SetUp,
        hole: int,
        rng: object = None,
        settings: LoopSettings | None = None,
        faults: Faults | None = None,
        built: SixAxisArm | None = None,
    ) -> None:
        rng = np.random.default_rng(rng)
        self.ready, self.hole = ready, hole
        self.settings = settings or LoopSettings()
        system = ready.system
        nominal = arm(system.arm)
        built = built or built_arm(ready, rng)
        self._clock()
        self._plan()
        seconds = self.settings.settle_s + self.settings.stay_s + 4.0
        seconds += self._span * (1.0 + 1.0 / self.settings.retraction) / system.insertion_mm_s
        self._ticks = int(1.5 * seconds / self._tick)
        self._inputs = self._gather(nominal, built, faults or Faults(), rng)
        self._work = Workspace.empty(self._lags)
        self._forces = self._force(rng)
        self._log = np.zeros((self._ticks // self._every_filter + 1, 11))
        self._at = 0
        self._state = self._start(nominal, built)

    def _clock(self) -> None:
        """Ticks that divide the cycles of tracker, fusion and robot."""
        system = self.ready.system
        cycles = [system.tracker_cycle_s, self.settings.sample_s, system.robot_cycle_s]
        parts = [max(1, round(1000 * cycle)) for cycle in cycles]
        common = gcd(*parts)
        self._tick = common / 1000.0
        self._every_sample, self._every_filter, self._every_command = (part // common for part in parts)
        self._delay = max(1, round(system.tracker_delay_s / self._tick))
        self._lags = max(1, round(system.tracker_delay_s / self.settings.sample_s))

    def _plan(self) -> None:
        """Where the drill should be, as the robot sees it."""
        ready = self.ready
        phantom, scene = ready.phantom, ready.scene
        self._entry, self._direction = phantom.entries[self.hole], phantom.directions[self.hole]
        self._first = -self.settings.approach_mm
        self._last = phantom.lengths[self.hole] + phantom.beyond_mm
        self._span = self._last - self._first
        middle = self._entry + 0.5 * phantom.lengths[self.hole] * self._direction
        towards = moved(inverse(phantom.T_rob_img), scene.camera) - middle
        self._R_img_tcp = facing_orientation(self._direction, towards, ready.T_tool_tcp)

    def _tcp(self, depth: float) -> np.ndarray:
        """T_rob_tcp that is wanted at a depth, without errors of registration."""
        return self.ready.phantom.T_rob_img @ rigid(self._R_img_tcp, self._entry + depth * self._direction)

    def _gather(
        self, nominal: SixAxisArm, built: SixAxisArm, faults: Faults, rng: np.random.Generator
    ) -> Inputs:
        ready, settings = self.ready, self.settings
        system, scene, tracker = ready.system, ready.scene, ready.tracker
        tilt = system.base_alignment_mrad * 1e-3 * rng.standard_normal(3)
        T_rob_base = rigid(cross_exponential(tilt), np.zeros(3)) @ scene.T_rob_base
        T_tcp_tool = inverse(scene.T_tool_tcp)
        ends = np.stack([self._tcp(self._first), self._tcp(self._last)])
        T_cam = np.concatenate(
            [scene.T_cam_rob @ ends @ T_tcp_tool, (scene.T_cam_rob @ T_rob_base)[None],
             (scene.T_cam_rob @ scene.T_rob_pat)[None]]
        )  # fmt: skip
        turns, shifts = difference(tracker.distorted(scene.marker, T_cam), T_cam)
        biases = np.concatenate([turns, shifts], axis=1)
        covariances = tracker.pose_covariance(scene.marker, T_cam)[1:]
        roots = np.linalg.cholesky(covariances + 1e-24 * np.eye(6))
        pictures = self._ticks // self._every_sample + 2
        noise = np.einsum("bij,nbj->nbi", roots, rng.standard_normal((pictures, 3, 6)))
        steps = self._ticks // self._every_filter + 2
        world = faults.over(
            pictures, system.tracker_cycle_s, self._ticks // self._every_command + 2, system.robot_cycle_s
        )
        stay = np.exp(-settings.sample_s / settings.wander_s)
        std = system.robot_repeatability_mm / REPEATABILITY_STDS
        drift = lfilter([np.sqrt(1 - stay**2)], [1, -stay], std * rng.standard_normal((steps, 3)), axis=0)
        measurement, thresholds = self._noise_readings(T_cam[1:], covariances)
        middle = self._tcp(0.5 * (self._first + self._last))
        T_ee_tool = scene.T_ee_tcp @ T_tcp_tool
        gain = twist_gain(
            nominal, built, middle @ inverse(scene.T_ee_tcp), scene.T_ee_tcp, T_ee_tool @ ready.T_tool_tcp
        )
        weights = np.array(
            [
                settings.static_weight,
                settings.moving_weight,
                settings.static_turn_weight,
                settings.moving_turn_weight,
            ]
        )
        control, safety = settings.control, settings.safety
        return Inputs(
            *_split(scene.T_cam_rob), *_split(T_rob_base), *_split(scene.T_rob_pat), *_split(ready.true_T_pat_img),
            *_split(T_tcp_tool), np.ascontiguousarray(gain), *_split(inverse(scene.T_rob_base)), *_split(ready.T_pat_img),
            *_split(ready.T_tool_tcp), self._entry.copy(), self._direction.copy(), quaternions(rigid(self._R_img_tcp)),
            biases[:2].copy(), biases[2], biases[3], noise, *world[:4], drift, np.ones(steps), world[4],
            control.gains, control.most, weights, thresholds[0], thresholds[1],
            np.square([[settings.position_process_mm, settings.velocity_process_mm_s],
                       [settings.rotation_process_rad, settings.spin_process_rad_s]]),
            measurement,
            float(stats.chi2.isf(settings.gate, 3)) if settings.gate > 0 else np.inf,
            self._tick, system.drive_lag_s, system.tracker_quantum_mm, self._first, self._last,
            system.insertion_mm_s, system.insertion_mm_s * settings.retraction, settings.wait_mm,
            settings.settle_s, settings.stay_s, safety.patient_jump_mm, safety.off_line_mm,
            self._every_filter, self._every_sample, self._every_command, self._delay,
            safety.frozen_samples, safety.missing_samples, safety.outlying_samples,
        )  # fmt: skip

    def _noise_readings(self, T_cam: np.ndarray, covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What a robot at rest reads of its noise: variances for the fusion, thresholds for the filters.

        The text computes the fusion's measurement noise from such readings (section 5.3). Of the base's
        marker, filtered like the patient's, only the share of noise that is left counts.
        """
        ready, settings = self.ready, self.settings
        R_rob_cam = ready.scene.T_rob_cam[:3, :3]
        tip = T_cam[0] @ ready.T_tool_tcp[:, 3]
        left = settings.static_weight / (2.0 - settings.static_weight)
        total = np.zeros((6, 6))
        for row, share in ((0, 1.0), (1, left)):
            to_tip = np.eye(6)
            to_tip[3:, :3] = -cross_matrices((tip[:3] - T_cam[row, :3, 3])[None])[0]
            total += share * to_tip @ covariances[row] @ to_tip.T
        turned = R_rob_cam @ total[:3, :3] @ R_rob_cam.T, R_rob_cam @ total[3:, 3:] @ R_rob_cam.T
        quantum = ready.system.tracker_quantum_mm**2 / 12.0
        tiny = 1e-12
        measurement = np.stack([
            np.diag(turned[1]) + quantum + tiny, np.full(3, settings.velocity_std_mm_s**2),
            np.diag(turned[0]) + tiny, np.full(3, settings.spin_std_rad_s**2),
        ])  # fmt: skip
        spread = np.array([
            [np.sqrt(np.trace(covariances[row, 3:, 3:]) + 3 * quantum), np.sqrt(np.trace(covariances[row, :3, :3]))]
            for row in (1, 2)
        ])  # fmt: skip
        return measurement, settings.moving_stds * spread

    def _force(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """By how much the bit is bent at depths of the hole, in two directions across it: (m,) and (m, 2) mm."""
        system = self.ready.system
        depths = np.arange(0.0, self._last + 1.0, 0.5)
        stay = np.exp(-0.5 / system.force_length_mm)
        white = rng.standard_normal((len(depths), 2))
        white[1:] *= np.sqrt(1 - stay**2)
        changing = lfilter([1.0], [1.0, -stay], white, axis=0)
        force = system.lateral_force_n * rng.standard_normal(2) + system.force_variation_n * changing
        slip = system.entry_slip_mm * rng.standard_normal(2) * np.exp(-depths / 3.0)[:, None]
        return depths, force / system.bit_stiffness_n_mm + slip

    def _start(self, nominal: SixAxisArm, built: SixAxisArm) -> State:
        """Before the first tick: where an arm that knows itself only nominally comes to when sent to the line."""
        scene, lags = self.ready.scene, self._lags
        start = self._tcp(self._first)
        q = nominal.inverse(start @ inverse(scene.T_ee_tcp))
        T = built.forward(q) @ scene.T_ee_tcp
        place, turn = T[:3, 3].copy(), quaternions(T)
        n = lags + 2
        position, rotation = np.zeros((3, n, n)), np.zeros((3, n, n))
        measurement = self._inputs.measurement
        position[:, : n - 1, : n - 1] = measurement[0][:, None, None]
        rotation[:, : n - 1, : n - 1] = measurement[2][:, None, None]
        position[:, n - 1, n - 1] = measurement[1]
        rotation[:, n - 1, n - 1] = measurement[3]
        six = [np.zeros(6) for _ in range(6)]
        return State(
            place.copy(), place, turn, *six, np.array([self._first]), np.zeros(1),
            np.zeros((3, n)), position, np.zeros((n - 1, 4)), np.zeros(3), rotation,
            np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4), np.zeros(3),
            np.zeros((self._delay // self._every_sample + 2, 21)), np.zeros(21), np.zeros(21),
            np.zeros(6, np.int64), np.zeros(1, bool), np.zeros(1, np.int64),
        )  # fmt: skip

    @property
    def status(self) -> Status:
        """State of the robot."""
        return Status(int(self._state.status[0]))

    @property
    def time_s(self) -> float:
        """Since the start."""
        return self._at * self._tick

    def run(self, until_s: float | None = None) -> Status:
        """Go on until the hole is done, the time is up, or `until_s`; a stopped robot stands and is watched.

        Parameters
        ----------
        until_s : float, optional
            Since the start.
        """
        last = self._ticks
        if until_s is not None:
            if not np.isfinite(until_s) or until_s < self.time_s:
                raise InputError(f"until_s: expected a time from {self.time_s:.3f} s on, got {until_s!r}")
            last = min(last, int(np.ceil(until_s / self._tick)))
        if self.status is not Status.DONE:
            self._at = _kernels.run(self._state, self._inputs, self._work, self._at, last, self._log)
        return self.status

    def resume(self) -> None:
        """Tell a stopped robot to go on.

        Raises
        ------
        GuidanceError
            If it is not stopped.
        """
        if not self.status.stopped:
            raise GuidanceError(f"resume: expected a stopped robot, it is {self.status.name}")
        self._state.integral[:] = 0.0
        for row in (1, 2, 5):
            self._state.counts[row] = 0
        self._state.status[0] = Status.RUNNING

    @property
    def result(self) -> DrilledHole:
        """The hole as far as it is."""
        rows = (self._at + self._every_filter - 1) // self._every_filter
        log = self._log[:rows]
        tip = log[:, :3].copy()
        depths, bent = self._forces
        along = (tip - self._entry) @ self._direction
        off = np.zeros((len(log), 3))
        inside = along > 0
        across = self._R_img_tcp[:, :2]
        for axis in range(2):
            off[inside] += np.interp(along[inside], depths, bent[:, axis])[:, None] * across[:, axis]
        return DrilledHole(
            self._entry, self._direction, self._last - self.ready.phantom.beyond_mm, self.ready.phantom.beyond_mm,
            np.arange(rows) * self._tick * self._every_filter, tip, log[:, 3:6].copy(), off, log[:, 6].copy(),
            log[:, 7].copy(), log[:, 8].astype(int), log[:, 9].astype(int),
        )  # fmt: skip


def drill_holes(
    ready: SetUp,
    rng: object = None,
    settings: LoopSettings | None = None,
    holes: Sequence[int] | None = None,
) -> list[DrilledHole]:
    """Drill a phantom's holes one after the other with one arm.

    Parameters
    ----------
    ready : SetUp
    rng : anything `numpy.random.default_rng` takes
    settings : LoopSettings, optional
    holes : sequence of int, optional
        All by default.

    Raises
    ------
    ReachError
        If the arm cannot take a pose.
    GuidanceError
        If the robot stopped, which it should not without faults.
    """
    rng = np.random.default_rng(rng)
    built = built_arm(ready, rng)
    done = []
    for hole in range(len(ready.phantom.entries)) if holes is None else holes:
        run = HoleRun(ready, hole, rng, settings, built=built)
        if run.run() is not Status.DONE:
            raise GuidanceError(
                f"hole {hole}: expected to end as DONE, it is {run.status.name} at {run.time_s:.2f} s"
            )
        done.append(run.result)
    return done


def built_arm(ready: SetUp, rng: np.random.Generator) -> SixAxisArm:
    """The system's arm as it was built, with joint zeros and link lengths a little off."""
    system = ready.system
    nominal = arm(system.arm)
    return ArmErrors(system.joint_bias_mrad * 1e-3, system.link_error_mm).sample(nominal, rng)


def twist_gain(
    nominal: SixAxisArm,
    built: SixAxisArm,
    T_rob_ee: np.ndarray,
    T_ee_tcp: np.ndarray,
    believed_T_ee_tcp: np.ndarray,
) -> np.ndarray:
    """(6, 6) twist of the tip that the arm makes over the one it is told, linear first, base axes.

    The control box turns a twist into joint speeds by the nominal arm and the believed lever, and the arm
    as built makes another twist of them: near 1, which is why differential commands need no calibrated arm.
    """
    q = nominal.inverse(T_rob_ee)
    R = T_rob_ee[:3, :3]
    out, back = np.eye(6), np.eye(6)
    out[:3, 3:] = -cross_matrices((R @ T_ee_tcp[:3, 3])[None])[0]
    back[:3, 3:] = cross_matrices((R @ believed_T_ee_tcp[:3, 3])[None])[0]
    return out @ differential_gain(nominal, built, q) @ back


def cross_exponential(vector: np.ndarray) -> np.ndarray:
    """(3, 3) rotation of a rotation vector in rad."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_rotvec(vector).as_matrix()


def _split(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of a transform, as the loop takes them."""
    return T[:3, 3].copy(), np.ascontiguousarray(quaternions(T))
