"""What the loop works on, as the named tuples that its kernel takes: state, inputs, room to work in."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from study._records import by_address
from study.guidance.fusion import workspace


@by_address
class State(NamedTuple):
    """All that changes while a hole is drilled; kept, so that a stopped robot can go on.

    Positions in mm and quaternions in the axes of the robot's base, unless the name says otherwise.
    """

    clean: np.ndarray  # (3,) tip without the arm's wandering
    p: np.ndarray  # (3,) true tip
    q: np.ndarray  # (4,) true orientation of the drill
    moving: np.ndarray  # (6,) twist that the arm believes it makes
    told: np.ndarray  # (6,) twist in execution
    pending: np.ndarray  # (6,) twist on its way to the arm
    held: np.ndarray  # (6,) twist by the encoders, on its way back
    reported: np.ndarray  # (6,) twist by the encoders, arrived
    integral: np.ndarray  # (6,) of the controller
    depth: np.ndarray  # (1,) mm of the desired tip beyond the entry
    rate: np.ndarray  # (1,) mm/s at which it goes on
    across: np.ndarray  # (1,) mm, estimated distance from the line
    x: np.ndarray  # (3, lags + 2) fusion of the position
    cov: np.ndarray  # (3, lags + 2, lags + 2)
    turns: np.ndarray  # (lags + 1, 4) fusion of the orientation
    spin: np.ndarray  # (3,) rad/s
    cov_turn: np.ndarray  # (3, lags + 2, lags + 2)
    base_p: np.ndarray  # (3,) base's marker, filtered, camera axes
    base_q: np.ndarray
    rob_p: np.ndarray  # (3,) robot's base from it, camera axes
    rob_q: np.ndarray
    patient_p: np.ndarray  # (3,) patient's marker, filtered, camera axes
    patient_q: np.ndarray
    wanted_p: np.ndarray  # (3,) desired tip
    wanted_q: np.ndarray
    line: np.ndarray  # (3,) direction of the planned line
    ring: np.ndarray  # (m, 21) pictures taken: tool, base, patient, each position and quaternion
    arrived: np.ndarray  # (21,) the picture that arrives
    last: np.ndarray  # (21,) and the one before
    counts: np.ndarray  # (6,) picture; not arrived; repeated; phase; steps in it; refused in a row
    flags: np.ndarray  # (1,) whether the fusion has begun
    status: np.ndarray  # (1,) see `study.guidance.safety`


@by_address
class Inputs(NamedTuple):
    """All that does not: what is true, what is believed, what the world does, and the settings."""

    # true
    cam_rob_p: np.ndarray
    cam_rob_q: np.ndarray
    rob_base_p: np.ndarray
    rob_base_q: np.ndarray
    rob_pat_p: np.ndarray
    rob_pat_q: np.ndarray
    true_pat_img_p: np.ndarray
    true_pat_img_q: np.ndarray
    tcp_tool_p: np.ndarray
    tcp_tool_q: np.ndarray
    gain: np.ndarray  # (6, 6) twist made over twist told
    # believed
    base_rob_p: np.ndarray
    base_rob_q: np.ndarray
    pat_img_p: np.ndarray
    pat_img_q: np.ndarray
    tool_tcp_p: np.ndarray
    tool_tcp_q: np.ndarray
    # planned, in the image's frame
    entry: np.ndarray
    direction: np.ndarray
    img_tcp_q: np.ndarray
    # the world
    tool_bias: np.ndarray  # (2, 6) at the first and at the last depth
    base_bias: np.ndarray  # (6,)
    patient_bias: np.ndarray  # (6,)
    noise: np.ndarray  # (pictures, 3, 6) of tool, base, patient
    spikes: np.ndarray  # (pictures, 3) mm
    seen: np.ndarray  # (pictures, 3) bool
    frozen: np.ndarray  # (pictures,) 1 repeats the last one, 2 brings nothing
    patient_shift: np.ndarray  # (pictures, 3) mm
    drift: np.ndarray  # (steps, 3) mm
    signal: np.ndarray  # (steps,) of the operator, 0 to 1
    handshake: np.ndarray  # (commands,) bool
    # settings
    gains: np.ndarray
    most: np.ndarray
    weights: np.ndarray
    base_thresholds: np.ndarray
    patient_thresholds: np.ndarray
    process: np.ndarray  # (2, 2) variances a step: position and velocity, rotation and angular velocity
    measurement: np.ndarray  # (4, 3) variances of position, velocity, rotation and angular velocity
    gates: np.ndarray  # (4, 2) largest NIS that is used in each phase, of position and orientation
    tick: float
    lag: float
    quantum: float
    first_depth: float
    last_depth: float
    speed: float
    speed_back: float
    feed_forward: float  # share of the desired tip's speed that is told in advance
    wait_mm: float
    settle_s: float
    stay_s: float
    patient_jump: float
    off_line: float
    every_filter: int
    every_sample: int
    every_command: int
    delay: int
    most_frozen: int
    most_missing: int
    most_outliers: int


@by_address
class Workspace(NamedTuple):
    """Room for what is worked out and forgotten."""

    p0: np.ndarray
    q0: np.ndarray
    p1: np.ndarray
    q1: np.ndarray
    six: np.ndarray
    zero: np.ndarray
    fusing: np.ndarray

    @classmethod
    def empty(cls, lags: int) -> Workspace:
        """Room for a fusion of so many lags."""
        three = [np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4), np.zeros(6), np.zeros(3)]
        return cls(*three, workspace(lags))
