"""The guided robot's loop in plain Python: 4x4 transforms, scipy's rotations, the printed 12-state matrices.

Nothing here is shared with the compiled loop but the tuples it takes; each part is written the way that a
textbook writes it, so that it can be read and believed.
"""

import numpy as np
from scipy.spatial.transform import Rotation

ZERO, ONE = np.zeros((3, 3)), np.eye(3)
RUNNING, DONE, LINE_OF_SIGHT, HANDSHAKE, FROZEN, OUTLIERS, PATIENT_MOVED, OFF_LINE = range(8)
ALIGN, INSERT, STAY, BACK = range(4)


def rotation(quaternion):
    return Rotation.from_quat(np.asarray(quaternion)[[1, 2, 3, 0]])


def transform(p, q):
    T = np.eye(4)
    T[:3, :3] = rotation(q).as_matrix()
    T[:3, 3] = p
    return T


def turned(T, rotvec, shift):
    """T after a small motion: turned about its own origin, then shifted, in the axes that T leads to."""
    out = T.copy()
    out[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix() @ T[:3, :3]
    out[:3, 3] += shift
    return out


class PatientFilter:
    """Low-pass of the position and SLERP of the orientation, heavy when static, light when moving."""

    def __init__(self, T):
        self.T = T.copy()

    def step(self, T, weights, thresholds):
        old, new = Rotation.from_matrix(self.T[:3, :3]), Rotation.from_matrix(T[:3, :3])
        turn = (new * old.inv()).as_rotvec()
        away = T[:3, 3] - self.T[:3, 3]
        moving = np.linalg.norm(away) > thresholds[0] or np.linalg.norm(turn) > thresholds[1]
        self.T[:3, 3] += weights[1 if moving else 0] * away
        self.T[:3, :3] = (Rotation.from_rotvec(weights[3 if moving else 2] * turn) * old).as_matrix()


class Kalman:
    """Equations 10 to 12 as matrices; positions add, orientations are turned by their errors."""

    def __init__(self, lags, sample_s, process, r_pose, r_velocity, P):
        n = lags + 2
        self.lags, self.sample_s = lags, sample_s
        A = np.zeros((3 * n, 3 * n))
        A[:3, :3] = A[-3:, -3:] = ONE
        A[:3, -3:] = sample_s * ONE
        for lag in range(lags):
            A[3 * lag + 3 : 3 * lag + 6, 3 * lag : 3 * lag + 3] = ONE
        self.A = A
        self.C = np.zeros((6, 3 * n))
        self.C[:3, -6:-3] = self.C[3:, -3:] = ONE
        self.Q = np.zeros((3 * n, 3 * n))
        self.Q[:3, :3] = process[0] * ONE
        self.Q[-3:, -3:] = process[1] * ONE
        self.R = np.diag(np.concatenate([r_pose, np.full(3, r_velocity)]))
        # (3, n, n) of each axis to the printed order.
        self.P = np.zeros((3 * n, 3 * n))
        for axis in range(3):
            self.P[axis::3, axis::3] = P[axis]
        self.first_P = self.P

    def restart(self):
        self.P = self.first_P

    def forget(self, std):
        """All poses may be elsewhere, by the same."""
        everywhere = np.tile(ONE, (self.lags + 1, 1)) * std
        self.P = self.P.copy()
        self.P[:-3, :-3] += everywhere @ everywhere.T

    def predict(self):
        self.P = self.A @ self.P @ self.A.T + self.Q

    def correct(self, innovation, fresh, gate):
        """NIS of the pose, and what all states change by."""
        nis = -1.0
        if fresh:
            S = self.C[:3] @ self.P @ self.C[:3].T + self.R[:3, :3]
            nis = float(innovation[:3] @ np.linalg.solve(S, innovation[:3]))
        rows = slice(0, 6) if fresh and nis <= gate else slice(3, 6)
        C, R = self.C[rows], self.R[rows, rows]
        K = self.P @ C.T @ np.linalg.inv(C @ self.P @ C.T + R)
        I_KC = np.eye(len(self.P)) - K @ C
        self.P = I_KC @ self.P @ I_KC.T + K @ R @ K.T
        return nis, K @ innovation[rows]


class PositionFusion(Kalman):
    def begin(self, position):
        self.x = np.concatenate([np.tile(position, self.lags + 1), np.zeros(3)])

    def step(self, z, velocity, fresh, gate):
        self.x = self.A @ self.x
        self.predict()
        innovation = np.concatenate([z, velocity]) - self.C @ self.x
        nis, change = self.correct(innovation, fresh, gate)
        self.x = self.x + change
        return nis

    @property
    def newest(self):
        return self.x[:3]


class OrientationFusion(Kalman):
    def begin(self, turn):
        self.turns, self.spin = [turn] * (self.lags + 1), np.zeros(3)

    def step(self, z, velocity, fresh, gate):
        newest = Rotation.from_rotvec(self.sample_s * self.spin) * self.turns[0]
        self.turns = [newest, *self.turns[:-1]]
        self.predict()
        innovation = np.concatenate([(z * self.turns[-1].inv()).as_rotvec(), velocity - self.spin])
        nis, change = self.correct(innovation, fresh, gate)
        self.turns = [
            Rotation.from_rotvec(change[3 * lag : 3 * lag + 3]) * turn for lag, turn in enumerate(self.turns)
        ]
        self.spin = self.spin + change[-3:]
        return nis

    @property
    def newest(self):
        return self.turns[0]


class PI:
    """Proportional and integral, cut to the most that may be commanded; the integral waits when cut."""

    def __init__(self, gain, rate, most, cycle):
        self.gain, self.rate, self.most, self.cycle = gain, rate, most, cycle
        self.integral = np.zeros(3)

    def step(self, error):
        wanted = self.gain * error + self.integral
        length = np.linalg.norm(wanted)
        if length > self.most:
            return wanted * self.most / length
        self.integral = self.integral + self.rate * self.cycle * error
        return wanted


class Reference:
    """The loop from its inputs and the state before the first tick, both as the compiled loop takes them."""

    def __init__(self, inputs, state):
        i = self.i = inputs
        self.T_cam_rob = transform(i.cam_rob_p, i.cam_rob_q)
        self.T_rob_base = transform(i.rob_base_p, i.rob_base_q)
        self.T_rob_pat = transform(i.rob_pat_p, i.rob_pat_q)
        self.T_tcp_tool = transform(i.tcp_tool_p, i.tcp_tool_q)
        self.true_T_pat_img = transform(i.true_pat_img_p, i.true_pat_img_q)
        self.T_base_rob = transform(i.base_rob_p, i.base_rob_q)
        self.T_pat_img = transform(i.pat_img_p, i.pat_img_q)
        self.T_tool_tcp = transform(i.tool_tcp_p, i.tool_tcp_q)
        self.clean = state.clean.copy()
        self.T_rob_tcp = transform(state.p, state.q)
        self.moving, self.told = np.zeros(6), np.zeros(6)
        self.pending, self.held, self.reported = np.zeros(6), np.zeros(6), np.zeros(6)
        self.depth, self.across = float(state.depth[0]), 0.0
        self.phase, self.steps_in_phase, self.status = ALIGN, 0, RUNNING
        lags, dt = state.x.shape[1] - 2, i.tick * i.every_filter
        r = i.measurement
        self.position = PositionFusion(lags, dt, i.process[0], r[0], r[1, 0], state.cov)
        self.orientation = OrientationFusion(lags, dt, i.process[1], r[2], r[3, 0], state.cov_turn)
        cycle = i.tick * i.every_command
        self.linear = PI(i.gains[0], i.gains[1], i.most[0], cycle)
        self.angular = PI(i.gains[2], i.gains[3], i.most[1], cycle)
        self.begun, self.rate = False, 0.0
        self.pictures, self.arrived = {}, None
        self.missing = self.repeated = self.refused = 0
        self.last = None
        self.log = []

    def resume(self):
        self.linear.integral, self.angular.integral = np.zeros(3), np.zeros(3)
        self.missing = self.repeated = self.refused = 0
        if self.status == OUTLIERS:
            self.position.forget(1000.0)
            self.orientation.forget(1.0)
        if self.status in (PATIENT_MOVED, OFF_LINE):
            self.begun = False
            self.position.restart()
            self.orientation.restart()
        self.status = RUNNING

    def expose(self, k):
        """What the tracker will say of the k-th picture: tool, base, patient, each a transform."""
        i = self.i
        share = np.clip((self.depth - i.first_depth) / (i.last_depth - i.first_depth), 0.0, 1.0)
        moved = self.T_rob_pat.copy()
        moved[:3, 3] += i.patient_shift[k]
        poses = (self.T_rob_tcp @ self.T_tcp_tool, self.T_rob_base, moved)
        biases = ((1 - share) * i.tool_bias[0] + share * i.tool_bias[1], i.base_bias, i.patient_bias)
        said = []
        for marker, (pose, bias) in enumerate(zip(poses, biases, strict=True)):
            motion = bias + i.noise[k, marker]
            seen = turned(self.T_cam_rob @ pose, motion[:3], motion[3:])
            if marker == 0:
                seen[:3, 3] += i.spikes[k]
            if i.quantum > 0:
                seen[:3, 3] = i.quantum * np.floor(seen[:3, 3] / i.quantum + 0.5)
            said.append(seen)
        self.pictures[k] = np.array(said)

    def deliver(self, k):
        """Whether the k-th picture may be used."""
        i = self.i
        if i.frozen[k] == 2:
            return False
        if i.frozen[k] == 0 or not self.begun:
            self.arrived = self.pictures[k]
        self.missing = 0
        if not i.seen[k].all():
            self.status = LINE_OF_SIGHT
            return False
        if i.most_frozen > 0:
            same = self.begun and np.array_equal(self.arrived, self.last)
            self.repeated = self.repeated + 1 if same else 0
            if self.repeated >= i.most_frozen:
                self.status = FROZEN
            if same:
                return False
        self.last = self.arrived
        if not self.begun:
            self.base, self.patient = PatientFilter(self.arrived[1]), PatientFilter(self.arrived[2])
            return True
        away = np.linalg.norm(self.arrived[2, :3, 3] - self.patient.T[:3, 3])
        if away > i.patient_jump and self.depth > 0:
            self.status = PATIENT_MOVED
            return False
        self.base.step(self.arrived[1], i.weights, i.base_thresholds)
        self.patient.step(self.arrived[2], i.weights, i.patient_thresholds)
        return True

    def operate(self, step, dt):
        before = self.depth
        self.step_phase(step, dt)
        self.rate = (self.depth - before) / dt if self.phase in (INSERT, BACK) else 0.0

    def step_phase(self, step, dt):
        i = self.i
        if self.phase == ALIGN:
            self.steps_in_phase += 1
            if self.steps_in_phase * dt >= i.settle_s and self.across < i.wait_mm:
                self.phase = INSERT
        elif self.phase == INSERT:
            if self.across < i.wait_mm:
                self.depth += i.speed * i.signal[step] * dt
            if self.depth >= i.last_depth:
                self.depth, self.phase, self.steps_in_phase = i.last_depth, STAY, 0
        elif self.phase == STAY:
            self.steps_in_phase += 1
            if self.steps_in_phase * dt >= i.stay_s:
                self.phase = BACK
        else:
            self.depth -= i.speed_back * dt
            if self.depth <= i.first_depth:
                self.status = DONE

    def filter_step(self, tick):
        i, dt, step = self.i, self.i.tick * self.i.every_filter, tick // self.i.every_filter
        fresh = False
        age = tick - i.delay
        if age >= 0 and age % i.every_sample < i.every_filter:
            self.missing += 1
            if self.status == RUNNING or not self.begun:
                fresh = self.deliver(age // i.every_sample)
            if self.missing > i.most_missing and self.status == RUNNING:
                self.status = LINE_OF_SIGHT
        nis = -1.0
        measured = np.eye(4)
        if fresh:
            T_rob_cam = np.linalg.inv(self.base.T @ self.T_base_rob)
            measured = T_rob_cam @ self.arrived[0] @ self.T_tool_tcp  # equation 5
            if not self.begun:
                self.position.begin(measured[:3, 3])
                self.orientation.begin(Rotation.from_matrix(measured[:3, :3]))
                self.begun = True
        if self.begun:
            gate, gate_turn = i.gates[self.phase]
            nis = self.position.step(measured[:3, 3], self.reported[:3], fresh, gate)
            turn = Rotation.from_matrix(measured[:3, :3])
            nis_turn = self.orientation.step(turn, self.reported[3:], fresh, gate_turn)
            if fresh:
                self.refused = self.refused + 1 if nis > gate or nis_turn > gate_turn else 0
                if self.refused >= i.most_outliers and self.status == RUNNING:
                    self.status = OUTLIERS
            T_img_tcp = transform(i.entry + self.depth * i.direction, i.img_tcp_q)
            T_rob_img = np.linalg.inv(self.base.T @ self.T_base_rob) @ self.patient.T @ self.T_pat_img
            self.wanted = T_rob_img @ T_img_tcp  # equation 6
            line = self.line = T_rob_img[:3, :3] @ i.direction
            self.across = float(np.linalg.norm(np.cross(self.position.newest - self.wanted[:3, 3], line)))
            if self.status == RUNNING:
                if self.across > i.off_line and self.depth > 0:
                    self.status = OFF_LINE
                else:
                    self.operate(step, dt)
        T_rob_pat = self.T_rob_pat.copy()
        T_rob_pat[:3, 3] += i.patient_shift[tick // i.every_sample]
        T_img_tcp = np.linalg.inv(T_rob_pat @ self.true_T_pat_img) @ self.T_rob_tcp
        self.log.append(
            [*T_img_tcp[:3, 3], *T_img_tcp[:3, 2], self.depth, self.across, self.status, self.phase, nis]
        )

    def command(self, tick):
        i = self.i
        self.reported, self.held = self.held, self.moving.copy()
        self.told, self.pending = self.pending, np.zeros(6)
        if self.status == RUNNING and not i.handshake[tick // i.every_command]:
            self.status = HANDSHAKE
        if self.status != RUNNING:
            self.told = np.zeros(6)
        elif self.begun:
            error = Rotation.from_matrix(self.wanted[:3, :3]) * self.orientation.newest.inv()
            vector = error.as_quat(canonical=True)[:3]
            self.pending = np.concatenate(
                [
                    self.linear.step(self.wanted[:3, 3] - self.position.newest)
                    + i.feed_forward * self.rate * self.line,
                    self.angular.step(2.0 * vector),
                ]
            )

    def arm(self, tick):
        i = self.i

        # A lag of first order towards what it is told; what it does in a tick is the mean of that.
        def speed(t):
            return self.told + np.exp(-t / i.lag) * (before - self.told)

        before = self.moving
        self.moving = speed(i.tick)
        nodes, weights = np.polynomial.legendre.leggauss(8)
        made = i.gain @ (weights @ [speed(i.tick * (x + 1) / 2) for x in nodes]) / 2
        self.clean = self.clean + i.tick * made[:3]
        self.T_rob_tcp[:3, 3] = self.clean + i.drift[tick // i.every_filter]
        self.T_rob_tcp[:3, :3] = Rotation.from_rotvec(i.tick * made[3:]).as_matrix() @ self.T_rob_tcp[:3, :3]

    def run(self, first, ticks):
        """Go on to tick `ticks`, or to the end; the tick after the last."""
        for tick in range(first, ticks):
            self.arm(tick)
            if tick % self.i.every_sample == 0:
                self.expose(tick // self.i.every_sample)
            if tick % self.i.every_filter == 0:
                self.filter_step(tick)
                if self.status == DONE:
                    return tick + 1
            if tick % self.i.every_command == 0:
                self.command(tick)
        return ticks
