"""A six-axis arm: where its end effector is, how it moves, and which joint angles take it somewhere."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError, ReachError
from study.robots.arms.inverse import REGULAR, inverse
from study.robots.arms.serial import Chain, SerialArm, angles
from study.robots.arms.table import ArmData, arm_data, arm_table

if TYPE_CHECKING:
    import pandas as pd

#: Axes of the joints of the upright arm, base axes: shoulder, upper arm, elbow, forearm, wrist, flange.
AXES = np.array([[0, 0, 1], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]], dtype=float)


def _placed(data: ArmData) -> np.ndarray:
    """(6, 4, 4) frames of the joints of the upright arm, each in the one before."""
    T = np.tile(np.eye(4), (6, 1, 1))
    T[1, :3, 3] = data.shoulder_offset, 0.0, data.base_height
    T[2, :3, 3] = 0.0, 0.0, data.upper_arm
    T[3, :3, 3] = data.elbow_offset, 0.0, data.forearm
    return T


@dataclass(frozen=True, eq=False)
class SixAxisArm(SerialArm):
    """An arm as drawn, or (`with_errors`) as built.

    Frames: *rob* is the arm's foot, z up along axis 1, x forward. *ee* lies where the axes of the wrist
    meet (Baron, 4.3), z out through the flange; with all joints 0 the arm is upright and *ee* parallel to
    *rob*. Units are mm, rad and s; six-vectors have the linear part first.

    Parameters
    ----------
    data : ArmData
        The arm as drawn.
    joint_bias : (6,) array
        rad by which the joints stand beyond what their encoders say.
    offsets : (6, 6) array
        By how much each joint's frame is off in the one before: mm along and rad about its own axes.

    Raises
    ------
    InputError
        If the errors have another shape or are not finite.

    Notes
    -----
    Kinematics are Pinocchio's, on a model built from the table in mm. Calls share that model's memory:
    one arm is not for two threads at once.
    """

    data: ArmData
    joint_bias: np.ndarray = field(default_factory=lambda: np.zeros(6))
    offsets: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))

    def __post_init__(self) -> None:
        for name, shape in (("joint_bias", (6,)), ("offsets", (6, 6))):
            values = np.array(getattr(self, name), dtype=float)
            if values.shape != shape or not np.isfinite(values).all():
                raise InputError(f"{name}: expected {shape} finite numbers, got shape {values.shape}")
            values.setflags(write=False)
            object.__setattr__(self, name, values)

    def __repr__(self) -> str:
        return f"SixAxisArm({self.name}, {'as built' if self.is_built else 'as drawn'})"

    @property
    def encoder_step_rad(self) -> float:
        """Smallest turn of a joint that its encoder tells, rad."""
        return self.data.encoder_step

    @property
    def source(self) -> pd.DataFrame:
        """Every value of the arm with its source, and whether it is verified; see `arm_table`."""
        return arm_table(self.name)

    @property
    def reach_mm(self) -> float:
        """Largest distance of the wrist's centre from axis 1 by the geometry, joint limits aside, mm."""
        return self.data.shoulder_offset + self.data.upper_arm + np.hypot(*self.fore)

    @property
    def T_ee_flange(self) -> np.ndarray:  # noqa: N802 - named as all transforms are
        """(4, 4) flange in the end effector's frame, mm."""
        T = np.eye(4)
        T[2, 3] = self.data.flange
        return T

    @property
    def ready(self) -> np.ndarray:
        """(6,) joint angles with the upper arm upright, the forearm level and the flange down, rad."""
        return self.data.senses * np.deg2rad([0.0, 0.0, 90.0, 0.0, 90.0, 0.0])

    @property
    def is_built(self) -> bool:
        """Whether it differs from the arm as drawn."""
        return bool(self.joint_bias.any() or self.offsets.any())

    @cached_property
    def nominal(self) -> SixAxisArm:
        """The arm as drawn: what the control box believes."""
        return SixAxisArm(self.data) if self.is_built else self

    def with_errors(self, joint_bias: ArrayLike, offsets: ArrayLike | None = None) -> SixAxisArm:
        """The arm as built, in place of errors it may already have.

        Parameters
        ----------
        joint_bias : (6,) array
            rad by which the joints stand beyond what their encoders say.
        offsets : (6, 6) array, optional
            By how much each joint's frame is off: mm along its own axes, then rad about them.

        Raises
        ------
        InputError
            If the shapes are others or a number is not finite.
        """
        return replace(self, joint_bias=joint_bias, offsets=np.zeros((6, 6)) if offsets is None else offsets)

    def inverse(self, T_rob_ee: ArrayLike, start: ArrayLike | None = None) -> np.ndarray:
        """Joint angles that take the end effector to a pose.

        Parameters
        ----------
        T_rob_ee : (4, 4) array
            mm.
        start : (6,) array, optional
            rad; the solution nearest to it is taken, `ready` when None.

        Returns
        -------
        (6,) array
            Joint angles within the limits, rad.

        Raises
        ------
        ReachError
            If the pose is beyond the arm's reach, takes a joint past its limit, or lies at a singularity
            (`regularity` below 0.01); the message says which and by how much.
        InputError
            If the pose is not rigid or `start` not six finite numbers.
        """
        return inverse(self, T_rob_ee, self.ready if start is None else angles(start))

    def absolute_error(self, q: ArrayLike) -> float | np.ndarray:
        """How far the end effector is from where the control box believes it to be.

        Parameters
        ----------
        q : (6,) or (n, 6) array
            rad.

        Returns
        -------
        float or (n,) array
            mm; 0 for an arm as drawn.
        """
        off = self.forward(q)[..., :3, 3] - self.nominal.forward(q)[..., :3, 3]
        length = np.linalg.norm(off, axis=-1)
        return float(length) if length.ndim == 0 else length

    def encoders(self, q: ArrayLike) -> np.ndarray:
        """Joint angles as the encoders tell them: (..., 6) rad, rounded to their step."""
        return np.round(np.asarray(q, dtype=float) / self.encoder_step_rad) * self.encoder_step_rad

    def encoder_twist(self, q_before: ArrayLike, q_after: ArrayLike, dt: float) -> np.ndarray:
        """Velocity of the end effector as the control box has it from the encoders.

        Parameters
        ----------
        q_before, q_after : (6,) array
            Joint angles at both ends of the interval, rad; rounded here to the encoders' step.
        dt : float
            s between the two.

        Returns
        -------
        (6,) array
            mm/s, then rad/s, axes of *rob*, of the arm as drawn, at the middle of the interval.

        Raises
        ------
        InputError
            If the angles are not six finite numbers or `dt` is not positive.
        """
        if not (np.isfinite(dt) and dt > 0):
            raise InputError(f"dt: expected a positive number of seconds, got {dt!r}")
        before, after = self.encoders(angles(q_before)), self.encoders(angles(q_after))
        return self.nominal.jacobian(0.5 * (before + after)) @ ((after - before) / dt)

    @property
    def fore(self) -> tuple[float, float]:
        """From axis 3 forward and up to the wrist's centre, upright, mm."""
        return self.data.elbow_offset, self.data.forearm

    @cached_property
    def chain(self) -> Chain:
        """Pinocchio's model of the arm, lengths in mm, made when first asked for."""
        import pinocchio as pin  # a tenth of a second, for those who move an arm

        axes = AXES * self.data.senses[:, None]
        placements = []
        for joint, placement in enumerate(_placed(self.data)):
            turned = pin.SE3(pin.exp3(axes[joint] * self.joint_bias[joint]), np.zeros(3))
            off = pin.exp6(pin.Motion(self.offsets[joint]))
            placements.append(pin.SE3(placement) * off * turned)
        return Chain.of(axes, placements)


@cache
def arm(name: str) -> SixAxisArm:
    """One of the two arms as drawn.

    Parameters
    ----------
    name : str
        One of `arm_names`.

    Raises
    ------
    InputError
        If there is no arm of that name.

    Examples
    --------
    >>> kr3 = arm("KR3")
    >>> kr3.forward(kr3.ready)[:3, 3].round(6).tolist()
    [370.0, 0.0, 615.0]
    """
    return SixAxisArm(arm_data(name))


def differential_gain(nominal: SixAxisArm, built: SixAxisArm, q: ArrayLike) -> np.ndarray:
    """What an arm does over what it was told, for small motions: J_built J_nominal^-1.

    Parameters
    ----------
    nominal : SixAxisArm
        The arm that the control box believes it moves.
    built : SixAxisArm
        The arm that moves.
    q : (6,) array
        Joint angles as the encoders tell them, rad.

    Returns
    -------
    (6, 6) array
        From commanded to executed small motions: mm, then rad, axes of *rob*. The unit matrix for an arm
        built as drawn.

    Raises
    ------
    ReachError
        If the arm is singular at `q`, where commands cannot be executed.
    InputError
        If `q` is not six finite numbers.
    """
    regularity = nominal.regularity(q)
    if regularity < REGULAR:
        raise ReachError(
            f"{nominal.name}: near a singularity: regularity {regularity:.2g}, expected at least {REGULAR}"
        )
    return np.linalg.solve(nominal.jacobian(q).T, built.jacobian(q).T).T
