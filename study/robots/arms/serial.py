"""What every six-axis arm of this room shares: the motion of its end effector, by Pinocchio."""

from __future__ import annotations

from dataclasses import fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError


class Chain(NamedTuple):
    """Pinocchio, the arm as its model, and the memory that it works in."""

    pin: object
    model: object
    data: object

    @classmethod
    def of(cls, axes: ArrayLike, placements: list) -> Chain:
        """Revolute joints about unit axes (6, 3), each placed (pinocchio.SE3, mm) in the one before."""
        import pinocchio as pin  # a tenth of a second, for those who move an arm

        model = pin.Model()
        parent = 0
        for joint, (axis, placement) in enumerate(zip(axes, placements, strict=True)):
            name = str(joint + 1)
            parent = model.addJoint(parent, pin.JointModelRevoluteUnaligned(axis), placement, name)
        return cls(pin, model, model.createData())


class SerialArm:
    """Base of the arms, which are frozen dataclasses with `data` and, made on demand, `chain` and `reach_mm`.

    Notes
    -----
    Calls share the memory of Pinocchio's model: one arm is not for two threads at once.
    """

    data: object  # with name, limits, speeds, repeatability and cycle
    chain: Chain
    reach_mm: float

    def __getstate__(self) -> dict[str, object]:
        """Without what is computed on demand: another process builds its own model."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @property
    def name(self) -> str:
        """Name of the arm."""
        return self.data.name

    @property
    def limits(self) -> np.ndarray:
        """(6, 2) smallest and largest joint angles, rad."""
        return self.data.limits

    @property
    def speeds(self) -> np.ndarray:
        """(6,) largest joint speeds, rad/s."""
        return self.data.speeds

    @property
    def repeatability_mm(self) -> float:
        """How well the arm comes back to a place, mm; says nothing of where that place is."""
        return self.data.repeatability

    @property
    def cycle_s(self) -> float:
        """Time between two commands, s."""
        return self.data.cycle

    def forward(self, q: ArrayLike) -> np.ndarray:
        """Where the end effector is.

        Parameters
        ----------
        q : (6,) or (n, 6) array
            Joint angles as the encoders tell them, rad; limits are not looked at.

        Returns
        -------
        (4, 4) or (n, 4, 4) array
            T_rob_ee, mm.

        Raises
        ------
        InputError
            If they are not six finite numbers each.
        """
        q = angles(q, many=True)
        chain = self.chain
        if q.ndim == 2:
            return np.array([self.forward(row) for row in q]).reshape(-1, 4, 4)
        chain.pin.forwardKinematics(chain.model, chain.data, q)
        return chain.data.oMi[6].homogeneous

    def jacobian(self, q: ArrayLike) -> np.ndarray:
        """How the end effector moves.

        Parameters
        ----------
        q : (6,) array
            rad.

        Returns
        -------
        (6, 6) array
            Velocity of the origin of *ee* (rows 0 to 2, mm) and rotation (rows 3 to 5, rad) in axes of
            *rob*, per rad of each joint.

        Raises
        ------
        InputError
            If `q` is not six finite numbers.
        """
        return self.pose_and_jacobian(q)[1]

    def pose_and_jacobian(self, q: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """`forward` and `jacobian` at once: (4, 4) and (6, 6)."""
        q = angles(q)
        pin, model, data = self.chain
        pin.computeJointJacobians(model, data, q)
        J = pin.getJointJacobian(model, data, 6, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        return data.oMi[6].homogeneous, J

    def regularity(self, q: ArrayLike) -> float:
        """Least singular value of the Jacobian, lengths over the arm's reach: 0 where the arm is singular.

        The arm's joints turn up to 1 / regularity times as fast as *ee* moves (in reaches) or turns.
        """
        return float(np.linalg.svd(self._scaled(self.jacobian(q)), compute_uv=False)[-1])

    def _scaled(self, J: np.ndarray) -> np.ndarray:
        """A Jacobian, or a six-vector, with its lengths over the arm's reach."""
        scaled = J.copy()
        scaled[:3] /= self.reach_mm
        return scaled


def angles(q: ArrayLike, many: bool = False) -> np.ndarray:
    """(6,), or also (n, 6), finite joint angles."""
    q = np.asarray(q, dtype=float)
    right = q.shape == (6,) or (many and q.ndim == 2 and q.shape[1] == 6)
    if not right or not np.isfinite(q).all():
        raise InputError(
            f"joint angles: expected six finite numbers{' each' if many else ''} (rad), "
            f"got {q.tolist() if q.size <= 12 else f'shape {q.shape}'}"
        )
    return q
