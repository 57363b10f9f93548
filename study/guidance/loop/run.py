"""A hole being drilled: what is true, believed and planned goes into the loop, its log comes out."""

from __future__ import annotations

from dataclasses import replace
from math import gcd

import numpy as np
from scipy.signal import lfilter

from study.errors import GuidanceError, InputError
from study.guidance.arm_motion import REPEATABILITY_STDS, nominal_angles, twist_gain
from study.guidance.faults import Faults
from study.guidance.frames import difference, inverse, moved, quaternions, rigid
from study.guidance.fusion import FusionSettings
from study.guidance.loop import _kernels
from study.guidance.loop.hole import DrilledHole
from study.guidance.loop.readings import marker_noise, tip_noise
from study.guidance.loop.records import Inputs, State, Workspace
from study.guidance.loop.settings import LoopSettings
from study.guidance.safety import Status
from study.guidance.scene import facing_orientation
from study.guidance.setting_up import SetUp

#: A hole may take so many times as long as it should.
_PATIENCE = 2.0
#: Depth within which a burr that slipped on the surface finds back, mm.
_SLIP_MM = 3.0
#: What is known of a pose that is not believed: mm and rad, one standard deviation.
_ANYWHERE_MM, _ANYWHERE_RAD = 1000.0, 1.0
#: For so long a robot that stopped is watched, s.
_WATCHED_S = 2.0
#: Longest step of the arm's motion, ms.
_LONGEST_TICK = 5


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

    Raises
    ------
    InputError
        If there is no such hole.
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
    ) -> None:
        rng = np.random.default_rng(rng)
        last = len(ready.phantom.entries) - 1
        if isinstance(hole, bool) or not isinstance(hole, int | np.integer) or not 0 <= hole <= last:
            raise InputError(f"hole: expected a whole number from 0 to {last}, got {hole!r}")
        self.ready, self.hole = ready, hole
        self.settings = settings or LoopSettings()
        self._plan()
        self._clock()
        self._inputs = self._gather(faults or Faults(), rng)
        self._forces = self._bending(rng)
        self._work = Workspace.empty(self._lags)
        self._log = np.zeros((self._ticks // self._every_filter + 1, 11))
        self._at = 0
        self._state = self._start()

    def _plan(self) -> None:
        """Where the drill should be, in the image."""
        phantom = self.ready.phantom
        self._entry, self._direction = phantom.entries[self.hole], phantom.directions[self.hole]
        self._first = -self.settings.approach_mm
        self._last = phantom.lengths[self.hole] + phantom.beyond_mm
        middle = self._entry + 0.5 * phantom.lengths[self.hole] * self._direction
        self._towards = moved(inverse(phantom.T_rob_img), self.ready.scene.camera) - middle

    def _clock(self) -> None:
        """Ticks that divide the tracker's cycle and delay, fusion and robot, and how many there can be."""
        system, settings = self.ready.system, self.settings
        cycles = [system.tracker_cycle_s, settings.fusion.sample_s, system.robot_cycle_s]
        parts = [max(1, round(1000 * time)) for time in (*cycles, system.tracker_delay_s)]
        common = gcd(*parts)
        common = next(ms for ms in range(min(common, _LONGEST_TICK), 0, -1) if common % ms == 0)
        self._tick = common / 1000.0
        self._every_sample, self._every_filter, self._every_command, self._delay = (
            part // common for part in parts
        )
        # A picture waits for the step of the fusion after it came.
        self._lags = -(-self._delay // self._every_filter)
        way = (self._last - self._first) * (1.0 + 1.0 / settings.retraction) / system.insertion_mm_s
        self._ticks = int(_PATIENCE * (settings.settle_s + settings.stay_s + way + 4.0) / self._tick)

    def _wanted(self, depth: float, T_tool_tcp: np.ndarray) -> np.ndarray:
        """T_img_tcp at a depth, turned so that the marker faces the camera."""
        R = facing_orientation(self._direction, self._towards, T_tool_tcp)
        return rigid(R, self._entry + depth * self._direction)

    def _on_paper(self, depth: float) -> np.ndarray:
        """T_rob_ee at a depth without any error, the same in every experiment."""
        scene = self.ready.scene
        return self.ready.phantom.T_rob_img @ self._wanted(depth, scene.T_tool_tcp) @ inverse(scene.T_ee_tcp)

    def _gather(self, faults: Faults, rng: np.random.Generator) -> Inputs:
        """All that the loop needs to know and does not change."""
        ready, settings, scene, system = self.ready, self.settings, self.ready.scene, self.ready.system
        T_tcp_tool = inverse(scene.T_tool_tcp)
        ends = np.stack([self._wanted(depth, ready.T_tool_tcp) for depth in (self._first, self._last)])
        T_rob_markers = np.stack(
            [*(ready.phantom.T_rob_img @ ends @ T_tcp_tool), scene.T_rob_base, scene.T_rob_pat]
        )
        T_cam_markers = scene.T_cam_rob @ T_rob_markers
        turns, shifts = difference(ready.tracker.distorted(scene.marker, T_cam_markers), T_cam_markers)
        biases = np.concatenate([turns, shifts], axis=1)
        covariances = ready.tracker.pose_covariance(scene.marker, T_cam_markers[1:])
        base, patient = (marker_noise(ready, covariance) for covariance in covariances[1:])
        tip = tip_noise(ready, settings.patient, T_cam_markers[1:3], covariances[:2])
        fusion = self._fusion = replace(settings.fusion, lags=self._lags).with_noise(tip)
        pictures = self._ticks // self._every_sample + 2
        commands = self._ticks // self._every_command + 2
        steps = self._ticks // self._every_filter + 2
        # Slightly more than nothing, where a tracker without noise has no root.
        roots = np.linalg.cholesky(covariances + 1e-24 * np.eye(6))
        noise = np.einsum("bij,nbj->nbi", roots, rng.standard_normal((pictures, 3, 6)))
        spikes, seen, frozen, shift, handshake = faults.over(
            pictures, self._tick * self._every_sample, commands, self._tick * self._every_command
        )
        middle = self._on_paper(0.5 * (self._first + self._last))
        believed = ready.T_ee_tool @ ready.T_tool_tcp
        jump = max(
            settings.safety.patient_jump_mm,
            settings.safety.patient_jump_stds * patient.distance_mm,
        )
        return Inputs(
            *_split(scene.T_cam_rob),
            *_split(scene.T_rob_base),
            *_split(scene.T_rob_pat),
            *_split(ready.true_T_pat_img),
            *_split(T_tcp_tool),
            twist_gain(ready.built, middle, scene.T_ee_tcp, believed),
            *_split(ready.T_base_rob),
            *_split(ready.T_pat_img),
            *_split(ready.T_tool_tcp),
            entry=self._entry.copy(),
            direction=self._direction.copy(),
            img_tcp_q=_split(ends[0])[1],
            tool_bias=biases[:2].copy(),
            base_bias=biases[2].copy(),
            patient_bias=biases[3].copy(),
            noise=noise,
            spikes=spikes,
            seen=seen,
            frozen=frozen,
            patient_shift=shift,
            drift=self._wandering(steps, rng),
            signal=np.ones(steps),
            handshake=handshake,
            gains=settings.control.gains,
            most=settings.control.most,
            weights=settings.patient.weights,
            base_thresholds=settings.patient.thresholds(base),
            patient_thresholds=settings.patient.thresholds(patient),
            process=fusion.process,
            measurement=np.stack(
                [
                    fusion.r_position,
                    np.full(3, fusion.r_velocity[0]),
                    fusion.r_rotation,
                    np.full(3, fusion.r_velocity[1]),
                ]
            ),
            gates=self._gates(fusion),
            tick=self._tick,
            lag=float(system.drive_lag_s),
            quantum=float(system.tracker_quantum_mm),
            first_depth=float(self._first),
            last_depth=float(self._last),
            speed=float(system.insertion_mm_s),
            speed_back=float(system.insertion_mm_s * settings.retraction),
            feed_forward=float(settings.feed_forward),
            wait_mm=float(settings.wait_mm),
            settle_s=float(settings.settle_s),
            stay_s=float(settings.stay_s),
            patient_jump=float(jump),
            off_line=float(settings.safety.off_line_mm),
            every_filter=self._every_filter,
            every_sample=self._every_sample,
            every_command=self._every_command,
            delay=self._delay,
            most_frozen=settings.safety.frozen_samples,
            most_missing=settings.safety.missing_samples,
            most_outliers=settings.safety.outlying_samples,
        )

    def _gates(self, fusion: FusionSettings) -> np.ndarray:
        """(4, 2) largest NIS that is used in each phase, of position and orientation.

        Where the arm changes its speed, how late its encoders are looks like an error, the more so the better
        the tracker is. As much of it as the speed of the phase makes is let pass.
        """
        speed = self.ready.system.insertion_mm_s
        speeds = np.array(
            [self.settings.control.most, [speed, 0], [speed, 0], [speed * self.settings.retraction, 0]]
        )
        late = 2.0 * self.ready.system.robot_cycle_s + fusion.sample_s
        stds = np.array([min(fusion.position_mm), min(fusion.rotation_rad)])
        return np.square(np.sqrt(fusion.largest_nis) + speeds * late / stds)

    def _wandering(self, steps: int, rng: np.random.Generator) -> np.ndarray:
        """(steps, 3) error of the arm's repeatability, which changes slowly and no encoder sees, mm."""
        stay = np.exp(-self.settings.fusion.sample_s / self.settings.wander_s)
        std = self.ready.system.robot_repeatability_mm / REPEATABILITY_STDS
        white = std * rng.standard_normal((steps, 3))
        white[1:] *= np.sqrt(1.0 - stay**2)
        return lfilter([1.0], [1.0, -stay], white, axis=0)

    def _bending(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """How far the bit's tip is bent at depths, in two directions across the hole: (m,) and (m, 2) mm."""
        system = self.ready.system
        depths = np.arange(0.0, self._last + 1.0, 0.5)
        stay = np.exp(-0.5 / system.force_length_mm)
        white = rng.standard_normal((len(depths), 2))
        white[1:] *= np.sqrt(1.0 - stay**2)
        changing = lfilter([1.0], [1.0, -stay], white, axis=0)
        force = system.lateral_force_n * rng.standard_normal(2) + system.force_variation_n * changing
        slip = system.entry_slip_mm * rng.standard_normal(2) * np.exp(-depths / _SLIP_MM)[:, None]
        return depths, force / system.bit_stiffness_n_mm + slip

    def _start(self) -> State:
        """Before the first tick: where an arm that knows itself on paper only comes to, sent to the line."""
        scene, n = self.ready.scene, self._lags + 2
        built = self.ready.built
        q = nominal_angles(built.name, self._on_paper(self._first))
        place, turn = _split(built.forward(q) @ scene.T_ee_tcp)
        covariances = self._fusion.first_covariances()
        twists = {name: np.zeros(6) for name in ("moving", "told", "pending", "held", "reported", "integral")}
        points = ("base_p", "rob_p", "patient_p", "wanted_p", "line", "spin")
        turns = ("base_q", "rob_q", "patient_q", "wanted_q")
        return State(
            clean=place.copy(),
            p=place,
            q=turn,
            **twists,
            **{name: np.zeros(3) for name in points},
            **{name: np.zeros(4) for name in turns},
            depth=np.array([float(self._first)]),
            rate=np.zeros(1),
            across=np.zeros(1),
            x=np.zeros((3, n)),
            cov=covariances[0],
            turns=np.zeros((n - 1, 4)),
            cov_turn=covariances[1],
            ring=np.zeros((self._delay // self._every_sample + 2, 21)),
            arrived=np.zeros(21),
            last=np.zeros(21),
            counts=np.zeros(6, np.int64),
            flags=np.zeros(1, bool),
            status=np.zeros(1, np.int64),
        )

    @property
    def status(self) -> Status:
        """State of the robot."""
        return Status(int(self._state.status[0]))

    @property
    def time_s(self) -> float:
        """Since the start."""
        return self._at * self._tick

    def run(self, until_s: float | None = None) -> Status:
        """Go on until the hole is done, the robot stops, the time is up, or `until_s`.

        A robot that stopped brakes and stands: it is watched for some two seconds, or to `until_s`.

        Parameters
        ----------
        until_s : float, optional
            Since the start.

        Raises
        ------
        InputError
            If that time is past.
        """
        last = self._ticks
        if until_s is not None:
            if not np.isfinite(until_s) or until_s < self.time_s:
                raise InputError(f"until_s: expected a time from {self.time_s:.3f} s on, got {until_s!r}")
            last = min(last, int(np.ceil(until_s / self._tick)))
        watched = last if until_s is not None else max(1, round(_WATCHED_S / self._tick))
        moving = True
        while moving and self._at < last and self.status is not Status.DONE:
            end = min(last, self._at + watched)
            self._at = _kernels.run(self._state, self._inputs, self._work, self._at, end, self._log)
            moving = not self.status.stopped
        return self.status

    def resume(self) -> None:
        """Tell a stopped robot to go on.

        Where it could not believe what it saw, it looks anew: after outliers the drill is where the next
        picture says; after a patient who moved, or a tip off its line, patient and base are so too. A tip
        that is still off its line in the bone stops the robot again.

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
        if self.status is Status.OUTLIERS:
            # All poses that the fusion remembers are as unknown, and alike: the next picture tells them.
            self._state.cov[:, :-1, :-1] += _ANYWHERE_MM**2
            self._state.cov_turn[:, :-1, :-1] += _ANYWHERE_RAD**2
        elif self.status in (Status.PATIENT_MOVED, Status.OFF_LINE):
            self._state.flags[0] = False
            self._state.cov[:], self._state.cov_turn[:] = self._fusion.first_covariances()
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
        sides = self._wanted(0.0, self.ready.scene.T_tool_tcp)[:3, :2]
        for axis in range(2):
            off[inside] += np.interp(along[inside], depths, bent[:, axis])[:, None] * sides[:, axis]
        beyond = self.ready.phantom.beyond_mm
        return DrilledHole(
            entry=self._entry,
            direction=self._direction,
            length=self._last - beyond,
            beyond=beyond,
            time_s=np.arange(rows) * self._tick * self._every_filter,
            tip=tip,
            axis=log[:, 3:6].copy(),
            bent=off,
            depth=log[:, 6].copy(),
            seen_across=log[:, 7].copy(),
            status=log[:, 8].astype(int),
            phase=log[:, 9].astype(int),
            nis=log[:, 10].copy(),
        )


def _split(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and quaternion of a transform, as the loop takes them."""
    return T[:3, 3].copy(), np.ascontiguousarray(quaternions(T))
