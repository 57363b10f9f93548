"""Compiled loop: arm, tracker, filters, control and guards, tick by tick, one hole at a time."""

from __future__ import annotations

from math import exp, floor, sqrt

from study._compiled import inner, threaded
from study.guidance._kernels import (
    exponential,
    inverse_multiply,
    multiply,
    multiply_inverse,
    normalise,
    turn,
    turn_back,
)
from study.guidance.control._kernels import steer
from study.guidance.filters._kernels import filter_pose
from study.guidance.fusion._kernels import fuse_orientation, fuse_position
from study.guidance.safety import (
    DONE,
    FROZEN,
    HANDSHAKE,
    LINE_OF_SIGHT,
    OFF_LINE,
    OUTLIERS,
    PATIENT_MOVED,
    RUNNING,
)

# Phases of the operator: find the line, insert, stay, come back.
_ALIGN = 0
_INSERT = 1
_STAY = 2
_BACK = 3


@inner
def _place(p, q, offset_p, offset_q, out_p, out_q):
    """Write the pose (p, q) times a fixed offset."""
    turn(q, offset_p, out_p)
    for i in range(3):
        out_p[i] += p[i]
    multiply(q, offset_q, out_q)


@inner
def _seen_from(p, q, base_p, base_q, out_p, out_q):
    """Write a pose as a base sees it: base^-1 times (p, q)."""
    for i in range(3):
        out_p[i] = p[i] - base_p[i]
    turn_back(base_q, out_p, out_p)
    inverse_multiply(base_q, q, out_q)


@inner
def _measure(p, q, bias, noise, spike, quantum, turned, out):
    """Write what the tracker says of a marker at (p, q): out[:3] the position, out[3:] the quaternion.

    Bias and noise are small motions: a rotation vector, then a shift of the marker's own origin.
    """
    exponential(bias[0] + noise[0], bias[1] + noise[1], bias[2] + noise[2], turned)
    multiply(turned, q, turned)
    for i in range(3):
        value = p[i] + bias[3 + i] + noise[3 + i] + spike[i]
        out[i] = quantum * floor(value / quantum + 0.5) if quantum > 0.0 else value
    for i in range(4):
        out[3 + i] = turned[i]


@inner
def _expose(s, inputs, k, share, w):
    """Take the k-th picture: what the tracker will deliver of tool, base and patient."""
    ring = s.ring[k % s.ring.shape[0]]
    # Where the drill and its marker truly are, seen by the camera.
    _place(s.p, s.q, inputs.tcp_tool_p, inputs.tcp_tool_q, w.p0, w.q0)
    _place(inputs.cam_rob_p, inputs.cam_rob_q, w.p0, w.q0, w.p1, w.q1)
    for i in range(6):
        w.six[i] = inputs.tool_bias[0, i] + share * (inputs.tool_bias[1, i] - inputs.tool_bias[0, i])
    _measure(w.p1, w.q1, w.six, inputs.noise[k, 0], inputs.spikes[k], inputs.quantum, w.q0, ring[:7])
    _place(inputs.cam_rob_p, inputs.cam_rob_q, inputs.rob_base_p, inputs.rob_base_q, w.p1, w.q1)
    _measure(w.p1, w.q1, inputs.base_bias, inputs.noise[k, 1], w.zero, inputs.quantum, w.q0, ring[7:14])
    for i in range(3):
        w.p0[i] = inputs.rob_pat_p[i] + inputs.patient_shift[k, i]
    _place(inputs.cam_rob_p, inputs.cam_rob_q, w.p0, inputs.rob_pat_q, w.p1, w.q1)
    _measure(w.p1, w.q1, inputs.patient_bias, inputs.noise[k, 2], w.zero, inputs.quantum, w.q0, ring[14:21])


@inner
def _deliver(s, inputs, k, w):
    """Take in the k-th picture as it arrives; True when the drill's pose in it may be used."""
    if inputs.frozen[k] == 2:  # nothing new comes
        return False
    if inputs.frozen[k] == 0 or not s.flags[0]:
        for i in range(21):
            s.arrived[i] = s.ring[k % s.ring.shape[0], i]
    # else: the picture before, delivered again
    s.counts[1] = 0
    if not (inputs.seen[k, 0] and inputs.seen[k, 1] and inputs.seen[k, 2]):
        s.status[0] = LINE_OF_SIGHT
        return False
    if inputs.most_frozen > 0:
        same = s.flags[0]
        for i in range(21):
            if s.arrived[i] != s.last[i]:
                same = False
        s.counts[2] = s.counts[2] + 1 if same else 0
        if s.counts[2] >= inputs.most_frozen:
            s.status[0] = FROZEN
        if same:
            return False  # old news
    for i in range(21):
        s.last[i] = s.arrived[i]
    if not s.flags[0]:
        for i in range(3):
            s.base_p[i] = s.arrived[7 + i]
            s.patient_p[i] = s.arrived[14 + i]
        for i in range(4):
            s.base_q[i] = s.arrived[10 + i]
            s.patient_q[i] = s.arrived[17 + i]
        _place(s.base_p, s.base_q, inputs.base_rob_p, inputs.base_rob_q, s.rob_p, s.rob_q)
        return True
    away = 0.0
    for i in range(3):
        away += (s.arrived[14 + i] - s.patient_p[i]) ** 2
    if sqrt(away) > inputs.patient_jump and s.depth[0] > 0.0:
        s.status[0] = PATIENT_MOVED
        return False
    filter_pose(s.base_p, s.base_q, s.arrived[7:10], s.arrived[10:14], inputs.weights, inputs.base_thresholds)
    filter_pose(
        s.patient_p,
        s.patient_q,
        s.arrived[14:17],
        s.arrived[17:21],
        inputs.weights,
        inputs.patient_thresholds,
    )
    _place(s.base_p, s.base_q, inputs.base_rob_p, inputs.base_rob_q, s.rob_p, s.rob_q)
    return True


@inner
def _desire(s, inputs, w):
    """Write where the drill should be, seen from the robot's base (equation 6)."""
    _seen_from(s.patient_p, s.patient_q, s.rob_p, s.rob_q, w.p0, w.q0)
    _place(w.p0, w.q0, inputs.pat_img_p, inputs.pat_img_q, w.p1, w.q1)
    for i in range(3):
        w.p0[i] = inputs.entry[i] + s.depth[0] * inputs.direction[i]
    _place(w.p1, w.q1, w.p0, inputs.img_tcp_q, s.wanted_p, s.wanted_q)
    turn(w.q1, inputs.direction, s.line)


@inner
def _begin(s, inputs, w):
    """Start the fusion from the first picture."""
    for axis in range(3):
        for lag in range(s.x.shape[1] - 1):
            s.x[axis, lag] = w.p1[axis]
        s.x[axis, s.x.shape[1] - 1] = 0.0
        s.spin[axis] = 0.0
    for lag in range(s.turns.shape[0]):
        for i in range(4):
            s.turns[lag, i] = w.q1[i]
    s.flags[0] = True


@inner
def _operate(s, inputs, step, dt, across):
    """Advance the drill along its line as the operator asks, who waits while it is off the line."""
    phase = s.counts[3]
    s.rate[0] = 0.0
    if phase == _ALIGN:
        s.counts[4] += 1
        if s.counts[4] * dt >= inputs.settle_s and across < inputs.wait_mm:
            s.counts[3] = _INSERT
    elif phase == _INSERT:
        if across < inputs.wait_mm:
            s.rate[0] = inputs.speed * inputs.signal[step]
            s.depth[0] += s.rate[0] * dt
        if s.depth[0] >= inputs.last_depth:
            s.depth[0] = inputs.last_depth
            s.rate[0] = 0.0
            s.counts[3] = _STAY
            s.counts[4] = 0
    elif phase == _STAY:
        s.counts[4] += 1
        if s.counts[4] * dt >= inputs.stay_s:
            s.counts[3] = _BACK
    else:
        s.rate[0] = -inputs.speed_back
        s.depth[0] += s.rate[0] * dt
        if s.depth[0] <= inputs.first_depth:
            s.status[0] = DONE


@inner
def _log(s, inputs, row, across, nis, w, out):
    """Write the truth of this moment, in the image's frame, and what the robot thinks."""
    sample = min(s.counts[0], inputs.patient_shift.shape[0] - 1)
    for i in range(3):
        w.p0[i] = inputs.rob_pat_p[i] + inputs.patient_shift[sample, i]
    _seen_from(s.p, s.q, w.p0, inputs.rob_pat_q, w.p1, w.q1)
    _seen_from(w.p1, w.q1, inputs.true_pat_img_p, inputs.true_pat_img_q, w.p0, w.q0)
    for i in range(3):
        out[row, i] = w.p0[i]
    w.p0[0] = 0.0
    w.p0[1] = 0.0
    w.p0[2] = 1.0
    turn(w.q0, w.p0, w.p0)
    for i in range(3):
        out[row, 3 + i] = w.p0[i]
    out[row, 6] = s.depth[0]
    out[row, 7] = across
    out[row, 8] = s.status[0]
    out[row, 9] = s.counts[3]
    out[row, 10] = nis


@threaded
def run(s, inputs, w, first, ticks, out):
    """Run the loop from tick `first` to tick `ticks` or to its end; return the tick after the last.

    A stop ends nothing: the arm brakes and the truth is written on, until the ticks are used up.
    """
    keep = exp(-inputs.tick / inputs.lag)
    kept = (1.0 - keep) * inputs.lag / inputs.tick  # the same, on average over the tick
    dt = inputs.tick * inputs.every_filter
    cycle = inputs.tick * inputs.every_command
    span = inputs.last_depth - inputs.first_depth
    across = s.across[0]
    nis = -1.0
    for tick in range(first, ticks):
        # The arm: a lag of first order, then what this arm makes of a command.
        for i in range(6):
            total = 0.0
            for j in range(6):
                total += inputs.gain[i, j] * (s.told[j] + kept * (s.moving[j] - s.told[j]))
            w.six[i] = total
        for i in range(6):
            s.moving[i] = s.told[i] + keep * (s.moving[i] - s.told[i])
        step = tick // inputs.every_filter
        for i in range(3):
            s.clean[i] += inputs.tick * w.six[i]
            s.p[i] = s.clean[i] + inputs.drift[step, i]
        exponential(inputs.tick * w.six[3], inputs.tick * w.six[4], inputs.tick * w.six[5], w.q0)
        multiply(w.q0, s.q, s.q)
        normalise(s.q)

        if tick % inputs.every_sample == 0:
            share = min(1.0, max(0.0, (s.depth[0] - inputs.first_depth) / span))
            s.counts[0] = tick // inputs.every_sample
            _expose(s, inputs, s.counts[0], share, w)

        if tick % inputs.every_filter == 0:
            fresh = False
            arriving = tick - inputs.delay
            if arriving >= 0 and arriving % inputs.every_sample < inputs.every_filter:
                k = arriving // inputs.every_sample
                usable = s.status[0] == RUNNING or not s.flags[0]
                s.counts[1] += 1
                if usable:
                    fresh = _deliver(s, inputs, k, w)
                if s.counts[1] > inputs.most_missing and s.status[0] == RUNNING:
                    s.status[0] = LINE_OF_SIGHT
            if fresh:
                # Where the tracker says the tip is, seen from the robot's base (equation 5).
                _seen_from(s.arrived[:3], s.arrived[3:7], s.rob_p, s.rob_q, w.p0, w.q0)
                _place(w.p0, w.q0, inputs.tool_tcp_p, inputs.tool_tcp_q, w.p1, w.q1)
                if not s.flags[0]:
                    _begin(s, inputs, w)
            if s.flags[0]:
                phase = s.counts[3]
                nis = fuse_position(
                    s.x, s.cov, dt, inputs.process[0], inputs.measurement[0], inputs.measurement[1, 0],
                    w.p1, s.reported[:3], fresh, inputs.gates[phase, 0], w.fusing,
                )  # fmt: skip
                turned = fuse_orientation(
                    s.turns, s.spin, s.cov_turn, dt, inputs.process[1], inputs.measurement[2],
                    inputs.measurement[3, 0], w.q1, s.reported[3:], fresh, inputs.gates[phase, 1], w.fusing,
                )  # fmt: skip
                if fresh:
                    bad = nis > inputs.gates[phase, 0] or turned > inputs.gates[phase, 1]
                    s.counts[5] = s.counts[5] + 1 if bad else 0
                    if s.counts[5] >= inputs.most_outliers and s.status[0] == RUNNING:
                        s.status[0] = OUTLIERS
                _desire(s, inputs, w)
                along = 0.0
                for i in range(3):
                    w.p0[i] = s.x[i, 0] - s.wanted_p[i]
                    along += w.p0[i] * s.line[i]
                total = 0.0
                for i in range(3):
                    total += (w.p0[i] - along * s.line[i]) ** 2
                across = sqrt(total)
                if s.status[0] == RUNNING:
                    if across > inputs.off_line and s.depth[0] > 0.0:
                        s.status[0] = OFF_LINE
                    else:
                        _operate(s, inputs, step, dt, across)
            _log(s, inputs, step, across, nis, w, out)
            if s.status[0] == DONE:
                s.across[0] = across
                return tick + 1

        if tick % inputs.every_command == 0:
            for i in range(6):
                s.reported[i] = s.held[i]  # what the encoders said a cycle ago
                s.held[i] = s.moving[i]
                s.told[i] = s.pending[i]  # and the command of a cycle ago
                s.pending[i] = 0.0
            if s.status[0] == RUNNING and not inputs.handshake[tick // inputs.every_command]:
                s.status[0] = HANDSHAKE
            if s.status[0] != RUNNING:
                for i in range(6):
                    s.told[i] = 0.0
            elif s.flags[0]:
                for i in range(3):
                    w.p0[i] = s.wanted_p[i] - s.x[i, 0]
                multiply_inverse(s.wanted_q, s.turns[0], w.q0)
                steer(w.p0, w.q0, inputs.gains, inputs.most, cycle, s.integral, s.pending)
                for i in range(3):
                    s.pending[i] += inputs.feed_forward * s.rate[0] * s.line[i]
    s.across[0] = across
    return ticks
