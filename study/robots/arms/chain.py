"""Arms told by parameters of Denavit and Hartenberg: no wrist whose axes meet is needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from study.errors import FileFormatError
from study.paths import data_path
from study.robots.arms.inverse import nearest_inverse
from study.robots.arms.serial import Chain, SerialArm, angles
from study.robots.arms.table import constant, numbers_of, read_arms, rows_of

if TYPE_CHECKING:
    import pandas as pd

_OF_ARM = {"repeatability": "mm", "cycle": "s", "payload": "kg"}
_OF_JOINT = {
    "d": "mm",
    "a": "mm",
    "alpha": "deg",
    "lower": "deg",
    "upper": "deg",
    "speed": "deg/s",
    "ready": "deg",
}


@dataclass(frozen=True, eq=False)
class ChainData:
    """An arm in numbers: mm, rad, s and kg.

    Attributes
    ----------
    name : str
    d, a, alpha : (6,) arrays
        Parameters of Denavit and Hartenberg: from joint i to the next along its own axis, along the common
        normal, and by how much the next axis is turned about that.
    limits : (6, 2) array
        Smallest and largest joint angles.
    speeds : (6,) array
        Largest joint speeds, rad/s.
    ready : (6,) array
        Joint angles to begin with.
    repeatability, cycle, payload : float
    """

    name: str
    d: np.ndarray
    a: np.ndarray
    alpha: np.ndarray
    limits: np.ndarray
    speeds: np.ndarray
    ready: np.ndarray
    repeatability: float
    cycle: float
    payload: float


@dataclass(frozen=True, eq=False)
class ChainArm(SerialArm):
    """A six-axis arm from its parameters of Denavit and Hartenberg.

    T_rob_ee is the product over the joints of Rot_z(q_i) Trans_z(d_i) Trans_x(a_i) Rot_x(alpha_i): *rob* is
    the arm's foot, z up along axis 1; *ee* is the flange, z out along axis 6. Units are mm, rad and s;
    six-vectors have the linear part first.

    Parameters
    ----------
    data : ChainData
        `a` and `alpha` of the last joint are 0: the flange is on axis 6.

    Notes
    -----
    Calls share the memory of Pinocchio's model: one arm is not for two threads at once.
    """

    data: ChainData

    def __repr__(self) -> str:
        return f"ChainArm({self.name})"

    @property
    def source(self) -> pd.DataFrame:
        """Every value of the arm with its source, and whether it is verified; as `arm_table`."""
        return rows_of(_table(), self.name)

    @property
    def reach_mm(self) -> float:
        """No less than the largest distance between an axis and the flange: all links stretched, mm."""
        return float(np.hypot(self.data.d, self.data.a)[1:].sum() + abs(self.data.a[0]))

    @property
    def ready(self) -> np.ndarray:
        """(6,) joint angles to begin with: upper arm upright, forearm level, flange down, rad."""
        return self.data.ready

    @cached_property
    def chain(self) -> Chain:
        """Pinocchio's model of the arm, lengths in mm, made when first asked for."""
        import pinocchio as pin  # a tenth of a second, for those who move an arm

        # The shift d along an axis may as well come before the turn about it: then the joint's frame is ee.
        placements = []
        before = pin.SE3.Identity()
        for d, a, alpha in zip(self.data.d, self.data.a, self.data.alpha, strict=True):
            placements.append(before * pin.SE3(np.eye(3), np.array([0.0, 0.0, d])))
            before = pin.SE3(pin.exp3(np.array([alpha, 0.0, 0.0])), np.array([a, 0.0, 0.0]))
        return Chain.of(np.tile([0.0, 0.0, 1.0], (6, 1)), placements)

    def inverse(self, T_rob_ee: ArrayLike, start: ArrayLike | None = None) -> np.ndarray:
        """Joint angles that take the flange to a pose, by damped least squares: for where to begin.

        Parameters
        ----------
        T_rob_ee : (4, 4) array
            mm.
        start : (6,) array, optional
            rad; the search begins here, at `ready` when None, and then with shoulder, elbow and wrist the
            other way round.

        Returns
        -------
        (6,) array
            Joint angles within the limits, rad; of those found, the nearest to `start`.

        Raises
        ------
        ReachError
            If no search ends at the pose, or only at joint angles beyond a limit or at a singularity.
        InputError
            If the pose is not rigid or `start` not six finite numbers.
        """
        return nearest_inverse(self, T_rob_ee, self.ready if start is None else angles(start))


@cache
def _table() -> pd.DataFrame:
    return read_arms(data_path("guided_arms.csv"), _OF_ARM, _OF_JOINT)


@cache
def guided_arm(name: str = "UR5") -> ChainArm:
    """An arm whose tool is guided by hand.

    Parameters
    ----------
    name : str
        "UR5": Universal Robots' UR5 of series 3, as its maker publishes it. Another published geometry, that
        of the Robotics Toolbox, has the shoulder 0.3 mm higher (d of joint 1: 89.459 in place of 89.159 mm);
        the table names what differs. An arm as built differs from either by more.

    Raises
    ------
    InputError
        If there is no arm of that name.
    FileFormatError
        If the table is not as it should be.

    Examples
    --------
    >>> ur5 = guided_arm("UR5")
    >>> ur5.forward(ur5.ready)[:3, 3].round(2).tolist()
    [-486.9, -109.15, 431.86]
    """
    whole, joints = numbers_of(rows_of(_table(), name))
    if joints.loc[6, ["a", "alpha"]].any():
        raise FileFormatError(
            f"guided_arms.csv: {name}: expected the flange on axis 6 (a and alpha of joint 6 are 0), "
            f"got {joints.loc[6, 'a']:g} mm and {joints.loc[6, 'alpha']:g} degrees"
        )
    turns = {quantity: np.deg2rad(joints[quantity].to_numpy(float)) for quantity in ("alpha", "ready")}
    return ChainArm(
        ChainData(
            name=name,
            **{quantity: constant(joints[quantity].to_numpy(float)) for quantity in ("d", "a")},
            **{quantity: constant(values) for quantity, values in turns.items()},
            limits=constant(np.deg2rad(joints[["lower", "upper"]].to_numpy(float))),
            speeds=constant(np.deg2rad(joints["speed"].to_numpy(float))),
            **{quantity: float(whole[quantity]) for quantity in _OF_ARM},
        )
    )
