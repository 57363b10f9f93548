"""What is known of the two arms: their geometry, limits and speeds, each value with its source."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from study.errors import FileFormatError, InputError
from study.paths import data_path

_COLUMNS = ["arm", "quantity", "joint", "value", "unit", "low", "high", "verified", "source"]
#: Quantities of the whole arm, and of each joint, with their units.
_OF_ARM = {
    "base_height": "mm",
    "shoulder_offset": "mm",
    "upper_arm": "mm",
    "elbow_offset": "mm",
    "forearm": "mm",
    "flange": "mm",
    "reach": "mm",
    "repeatability": "mm",
    "cycle": "s",
    "payload": "kg",
    "encoder_step": "rad",
}
_OF_JOINT = {"lower": "deg", "upper": "deg", "speed": "deg/s", "sense": "1"}


@dataclass(frozen=True, eq=False)
class ArmData:
    """An arm in numbers: lengths in mm of the upright arm (all joints 0), joints in rad.

    Attributes
    ----------
    name : str
    base_height : float
        From the foot up to axis 2.
    shoulder_offset : float
        From axis 1 forward (along x) to axis 2.
    upper_arm : float
        From axis 2 up to axis 3.
    elbow_offset, forearm : float
        From axis 3 forward and up to the wrist's centre, where axes 4, 5 and 6 meet.
    flange : float
        From the wrist's centre up to the flange.
    reach : float
        Printed largest distance of the wrist's centre from axis 1: only a check of the geometry.
    repeatability : float
        mm.
    cycle : float
        s, in which commands and joint angles are exchanged.
    payload : float
        kg.
    encoder_step : float
        rad, the smallest turn of a joint that its encoder tells.
    limits : (6, 2) array
        Smallest and largest joint angles.
    speeds : (6,) array
        Largest joint speeds, rad/s.
    senses : (6,) array
        1 where a joint turns about +z, +y, +y, +z, +y, +z of the upright arm, -1 where against it.
    """

    name: str
    base_height: float
    shoulder_offset: float
    upper_arm: float
    elbow_offset: float
    forearm: float
    flange: float
    reach: float
    repeatability: float
    cycle: float
    payload: float
    encoder_step: float
    limits: np.ndarray
    speeds: np.ndarray
    senses: np.ndarray


@cache
def _table() -> pd.DataFrame:
    return read_arms(data_path("robot_arms.csv"), _OF_ARM, _OF_JOINT)


def read_arms(path: Path, of_arm: dict[str, str], of_joint: dict[str, str]) -> pd.DataFrame:
    """A table of arms, checked: every quantity of an arm and of its six joints once, in its unit.

    Raises
    ------
    FileFormatError
        If a column, a line, a unit or a source is missing.
    """
    table = pd.read_csv(path, dtype={"joint": "Int64"})
    if list(table.columns) != _COLUMNS:
        raise FileFormatError(f"{path}: expected columns {_COLUMNS}, got {list(table)}")
    full = table[["arm", "quantity", "value", "unit", "verified", "source"]]
    if full.isna().any(axis=None) or not table["verified"].isin(["yes", "no"]).all():
        raise FileFormatError(
            f"{path}: expected a value, its unit, verified (yes or no) and a source in every line"
        )
    table["verified"] = table["verified"] == "yes"
    wanted = [(quantity, 0, unit) for quantity, unit in of_arm.items()]
    wanted += [(quantity, joint, unit) for quantity, unit in of_joint.items() for joint in range(1, 7)]
    for name, rows in table.groupby("arm", sort=False):
        got = zip(rows["quantity"], rows["joint"].fillna(0), rows["unit"], strict=True)
        if sorted(got) != sorted(wanted):
            raise FileFormatError(f"{path}: {name}: expected one line each of {sorted(wanted)}")
    return table


def arm_names() -> tuple[str, ...]:
    """Names of the arms: ``"KR3"`` (KUKA KR 3, Hannover) and ``"RV-3S"`` (Mitsubishi, Vanderbilt)."""
    return tuple(_table()["arm"].unique())


def arm_table(name: str) -> pd.DataFrame:
    """Everything known of an arm, and how it is known.

    Parameters
    ----------
    name : str
        One of `arm_names`.

    Returns
    -------
    pandas.DataFrame
        Columns ``quantity``, ``joint`` (1 to 6, missing for what concerns the whole arm), ``value``,
        ``unit``, ``low`` and ``high`` (a plausible range where the value is only plausible), ``verified``
        (bool: False for a value from memory, deduced or plausible) and ``source``.

    Raises
    ------
    InputError
        If there is no arm of that name.
    FileFormatError
        If the table is not as it should be.
    """
    return rows_of(_table(), name)


def rows_of(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """The lines of one arm; `InputError` if there is none of that name."""
    names = table["arm"].unique()
    if name not in names:
        raise InputError(f"arm: expected one of {', '.join(names)}, got {name!r}")
    return table[table["arm"] == name].drop(columns="arm").reset_index(drop=True)


def numbers_of(table: pd.DataFrame) -> tuple[pd.Series, pd.DataFrame]:
    """Values of one arm's `rows_of`: of the whole arm, and of its joints (1 to 6 by quantity)."""
    whole = table[table["joint"].isna()].set_index("quantity")["value"]
    joints = table[table["joint"].notna()].pivot_table(index="joint", columns="quantity", values="value")
    return whole, joints


@cache
def arm_data(name: str) -> ArmData:
    """The numbers of an arm.

    Parameters
    ----------
    name : str
        One of `arm_names`.

    Raises
    ------
    InputError, FileFormatError
        See `arm_table`.
    """
    whole, joints = numbers_of(arm_table(name))
    return ArmData(
        name=name,
        **{quantity: float(whole[quantity]) for quantity in _OF_ARM},
        limits=constant(np.deg2rad(joints[["lower", "upper"]].to_numpy(float))),
        speeds=constant(np.deg2rad(joints["speed"].to_numpy(float))),
        senses=constant(joints["sense"].to_numpy(float)),
    )


def constant(values: np.ndarray) -> np.ndarray:
    """The same numbers, not to be written to."""
    values = np.ascontiguousarray(values)
    values.setflags(write=False)
    return values
