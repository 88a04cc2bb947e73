"""Bodies on a moving base, joined by axes through one point, and the true values of a loop by an oracle of its own.

The equations of motion are written down here for small angles q of the joints, on a base that turns at W (3,):

    M q'' + D q' + K q = S Q - M_W W',    M_ij = sum over bodies that both carry of a_i I a_j,

with springs, friction and the weight of moments in a specific force. The loop is that of `continuous_loop`. Nothing of
the package's loop code is used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from continuous_loop import ContinuousLoop, response

G = 9.81
BASE = "base"


class Body(NamedTuple):
    """A body with the joint that carries it; `parent` is the number of another body, -1 the base."""

    name: str
    parent: int
    axis: tuple[float, float, float]
    inertia: list[list[float]]
    stiffness: float = 0.0
    viscous: float = 0.0
    moment: tuple[float, float, float] = (0.0, 0.0, 0.0)
    driven: bool = False


class Tree(NamedTuple):
    """A job of one loop on the driven bodies, read at the last of them: SI units, Hz; times in sample periods."""

    bodies: tuple[Body, ...]
    rate_hz: float
    delay: float
    lag: float
    bandwidth_hz: float  # of the gyros; 0: none
    late: float  # of the sensors
    crossover_hz: float
    integral_hz: float
    double_hz: float = 0.0  # 0: no second integral
    fed: bool = False  # feedforward of the base's rate, whose gyros are as good
    pointing: bool = False  # an attitude sensor in place of gyros

    @property
    def period(self) -> float:
        return 1.0 / self.rate_hz

    @property
    def camera(self) -> int:
        return max(k for k, body in enumerate(self.bodies) if body.driven)

    def job(self, limits: dict[str, float], omega: float = 0.3) -> dict[str, object]:
        """The job as `read_job` takes it."""
        T, driven = self.period, [body for body in self.bodies if body.driven]
        method = "classical" if self.pointing else "pi"
        crossover = "inertial_crossover_hz" if self.pointing else "crossover_hz"
        design = {"name": method, "method": method, crossover: self.crossover_hz, "integral_hz": self.integral_hz}
        design |= {"double_integral_hz": self.double_hz} if self.double_hz else {}
        design |= {"feedforward": {"sensors": ["base1", "base2", "base3"]}} if self.fed else {}
        timing = {"delay": self.late * T}
        gyro = timing | {"noise_density": 6e-5} | ({"bandwidth_hz": self.bandwidth_hz} if self.bandwidth_hz else {})
        camera = self.bodies[self.camera].name
        axes = [{"name": f"read_{body.name}", "body": camera, "axis": list(body.axis)} for body in driven]
        base = [{"name": f"base{k}", "root_axis": k} | gyro for k in (1, 2, 3)]
        plant = {
            "schema": 1,
            "name": "tree",
            "source": "assumed",
            "root": {"name": BASE, "inertia": [10.0, 10.0, 10.0], "specific_force": [0.0, 0.0, -G]},
            "gimbal": [
                {
                    "name": body.name,
                    "parent": BASE if body.parent < 0 else self.bodies[body.parent].name,
                    "axis": list(body.axis),
                    "inertia": body.inertia,
                }
                for body in self.bodies
            ],
            "torquer": [{"gimbal": body.name, "limit": 1.0, "lag": self.lag * T} for body in driven],
            "friction": [{"gimbal": body.name, "viscous": body.viscous} for body in self.bodies if body.viscous],
            "spring": [{"gimbal": body.name, "stiffness": body.stiffness} for body in self.bodies if body.stiffness],
            "unbalance": [{"body": body.name, "moment": list(body.moment)} for body in self.bodies if any(body.moment)],
            "line_of_sight": {"body": camera, "direction": [1, 0, 0]},
            "rate_sensor": base + ([] if self.pointing else [one | gyro for one in axes]),
            "attitude_sensor": [one | timing | {"noise_density": 1e-6} for one in axes] if self.pointing else [],
        }
        loop = {
            "name": "los",
            "kind": "pointing" if self.pointing else "rate",
            "gimbals": [body.name for body in driven],
            "sensors": [one["name"] for one in axes],
            "use": method,
        }
        return {
            "schema": 2,
            "name": "tree",
            "plant": {key: item for key, item in plant.items() if item != []},
            "operation": {"Omega": [omega] * 3},
            "sampling": {"rate_hz": self.rate_hz, "delay": self.delay * T},
            "loop": [loop | {"limits": limits, "design": [design]}],
        }

    @property
    def path(self) -> np.ndarray:
        """Whether the joint j carries body i, (n, n)."""
        out = np.zeros((len(self.bodies),) * 2)
        for i in range(len(self.bodies)):
            j = i
            while j >= 0:
                out[i, j], j = 1.0, self.bodies[j].parent
        return out

    @property
    def mechanics(self) -> tuple[np.ndarray, ...]:
        """M, D, K, M_W of the equations of motion."""
        n, a = len(self.bodies), np.array([np.asarray(body.axis) / np.linalg.norm(body.axis) for body in self.bodies])
        inertia = np.array([body.inertia for body in self.bodies])
        M = np.einsum("bi,bj,ix,bxy,jy->ij", self.path, self.path, a, inertia, a)
        M_W = np.einsum("bi,ix,bxy->iy", self.path, a, inertia)
        K = np.diag([body.stiffness for body in self.bodies])
        f = np.array([0.0, 0.0, -G])
        for b, body in enumerate(self.bodies):
            # The potential is -f r of the moment, turned by the joints that carry it, the outer one last.
            for i in range(n):
                for j in range(n):
                    if self.path[b, i] and self.path[b, j]:
                        outer, inner = (i, j) if self.path[j, i] else (j, i)
                        # Torque about an axis is a (r x -f): f is what the fixed point's support gives.
                        K[i, j] += f @ np.cross(a[outer], np.cross(a[inner], body.moment))
        return M, np.diag([body.viscous for body in self.bodies]), K, M_W


class Truth:
    """The true values of a controller (A, B, C, D) from the readings, with feedforward from the base's gyros behind."""

    def __init__(self, one: Tree, K, noise: np.ndarray) -> None:
        self.one, self.noise, T = one, np.asarray(noise), one.period
        bodies, n = one.bodies, len(one.bodies)
        M, D, K_joints, M_W = one.mechanics
        a = np.array([np.asarray(body.axis) / np.linalg.norm(body.axis) for body in bodies])
        at = [k for k, body in enumerate(bodies) if body.driven]
        p, f = len(at), 3
        # Coordinates are sums of angles along the paths: a light body between two others would cost digits.
        back = np.linalg.inv(one.path)
        M, D, K_q, M_W, S = (back.T @ item for item in (M @ back, D @ back, K_joints @ back, M_W, np.eye(n)[:, at]))
        inverse = np.linalg.inv(M)
        X = inverse @ M_W
        # Rates of the camera about the readings' axes: turn q' + axes W.
        axes, carried = a[at], one.path[one.camera]
        turned = (a * carried[:, None]).T @ back
        turn = axes @ turned
        filters = 2 * (p + f) if one.bandwidth_hz else 0
        # States: q, v = q' + X W, low-passes of the readings and of the base's gyros, and the base's rotation (3).
        size = 2 * n + filters + 3
        A, B_u, B_w = np.zeros((size, size)), np.zeros((size, len(at))), np.zeros((size, 3))
        A[:n, n : 2 * n], B_w[:n] = np.eye(n), -X
        A[n : 2 * n, :n], A[n : 2 * n, n : 2 * n], B_w[n : 2 * n] = -inverse @ K_q, -inverse @ D, inverse @ D @ X
        B_u[n : 2 * n] = inverse @ S
        B_w[-3:] = np.eye(3)
        rate, rate_W = np.zeros((p + f, size)), np.vstack([axes - turn @ X, np.eye(3)])
        rate[:p, n : 2 * n] = turn
        C_y, D_yw = rate.copy(), rate_W.copy()
        if one.bandwidth_hz:
            w = 2.0 * np.pi * one.bandwidth_hz
            for k in range(p + f):
                i = 2 * n + 2 * k
                A[i, i + 1] = w
                A[i + 1, i : i + 2] = -w, -np.sqrt(2.0) * w
                A[i + 1] += w * rate[k]
                B_w[i + 1] = w * rate_W[k]
                C_y[k], D_yw[k] = 0.0, 0.0
                C_y[k, i] = 1.0
        if one.pointing:
            C_y[:p], D_yw[:p] = 0.0, 0.0
            C_y[:p, :n], C_y[:p, -3:] = turn, axes
        if not one.fed:
            C_y, D_yw = C_y[:p], D_yw[:p]
        self.p, late = p, int(np.ceil(one.late - 1e-9))
        self.both = tuple(np.asarray(item, dtype=float) for item in K[:4])
        self.own = (self.both[0], self.both[1][:, :p], self.both[2], self.both[3][:, :p])
        # The line of sight is [1, 0, 0]: rates across it are those about 2 and 3, as far as torquers move them.
        across = np.eye(3)[1:]
        sight, sight_W = np.zeros((2, size)), across - across @ turned @ X
        sight[:, n : 2 * n] = across @ turned
        moved = np.abs(sight[:, n : 2 * n] @ inverse @ S).max(axis=1) > 1e-9 * np.abs(inverse).max()

        def loop(states, B, C_y, D_yw, K, C_z, D_zw):
            plant = (A[states][:, states], B_u[states], B[states], C_y[:, states], C_z[:, states], D_yw, D_zw)
            lags = [one.lag * T] * len(at)
            return ContinuousLoop(plant, K, T, delay=one.delay * T, lag=lags, late=[late] * len(C_y))

        whole, inner = np.arange(size), np.arange(2 * n + (2 * p if one.bandwidth_hz else 0))
        self.of_sight = loop(whole, B_w, C_y, D_yw, self.both, sight[moved], sight_W[moved])
        self.of_rate = loop(whole, B_w, C_y, D_yw, self.both, C_y[:p], D_yw[:p])
        none = np.zeros((p, len(at)))
        self.loop = self.of_torque = loop(inner, B_u, C_y[:p], none, self.own, C_y[:p], none)
        poles = self.loop.poles()
        poles = poles[np.argsort(np.abs(poles - 1.0))]
        # Equilibria that gyros do not see: torques of springs on driven bodies are what integrals give.
        others = [k for k in range(n) if k not in at]
        integrals = int((np.abs(np.linalg.eigvals(self.own[0]) - 1.0) < 1e-9).sum())
        held = K_joints[others] if integrals >= p else K_joints
        self.free = 0 if one.pointing else n - (np.linalg.matrix_rank(held) if len(held) else 0)
        assert np.all(np.abs(poles[: self.free] - 1.0) < 1e-5), poles[: self.free]
        self.poles = poles[self.free :]
        with np.errstate(divide="ignore", invalid="ignore"):
            self.s = np.log(self.poles.astype(complex)) / T
        self.s = self.s[np.isfinite(self.s)]
        self.stable = bool(np.abs(self.poles).max() < 1.0)
        self.slow = float(np.abs(self.s)[np.abs(self.s) > 1e-12].min())
        self.decay = float(-self.s.real.max())
        self.modes = np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K_q, -inverse @ D]]))

    def grid(self, low: float, high: float) -> np.ndarray:
        """Frequencies from `low` to `high`, dense around every pole of the loop and of the plant."""
        s = np.concatenate([self.s, self.modes])
        offsets = np.concatenate([np.linspace(-4.0, 4.0, 41), *(np.geomspace(4.0, 1e4, 30) * sign for sign in (1, -1))])
        near = [np.abs(p.imag) + offsets * max(np.abs(p.real), 1e-9 * np.abs(p)) for p in s]
        w = np.concatenate([np.geomspace(low, high, 2000), *near, np.abs(s), [high]])
        return np.unique(w[(w >= low) & (w <= high)])

    def parts(self, w):
        """P and K, (F, p, m) and (F, m, p)."""
        A, B, C, D = self.own
        return self.loop.sampled_plant(w), response(A, B, C, np.exp(1j * w * self.one.period)) + D

    def channels(self, w):
        """L of each torquer with all others closed, (F, m)."""
        P, K = self.parts(w)
        S = np.linalg.inv(np.eye(K.shape[1]) - K @ P)
        return 1.0 / np.diagonal(S, axis1=1, axis2=2) - 1.0

    def _roots(self, w, of):
        """Frequencies and channels at which a real function (F, m) of L changes its sign."""
        values = of(self.channels(w))
        at, channel = np.nonzero(values[1:] * values[:-1] < 0.0)
        low, high, start = w[at].copy(), w[at + 1].copy(), values[at, channel]
        for _ in range(45 if len(at) else 0):
            middle = 0.5 * (low + high)
            same = of(self.channels(middle))[np.arange(len(at)), channel] * start > 0.0
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return low, channel

    def margins(self, w) -> tuple[float, float]:
        """Gain margin, dB, and phase margin, degrees."""
        found, channel = self._roots(w, np.imag)
        L = self.channels(found)[np.arange(len(found)), channel] if len(found) else np.zeros(0)
        ends = self.channels(w[[0, -1]]).ravel()
        ends = ends[(ends.real < 0.0) & (np.abs(ends.imag) < 0.02 * np.abs(ends.real))]
        # Through a pole of L the sign changes, too.
        L = np.append(L[(L.real < 0.0) & (np.abs(L.imag) < 1e-4 * np.abs(L.real))], ends)
        gain = float(np.abs(20.0 * np.log10(np.abs(L))).min(initial=np.inf))
        found, channel = self._roots(w, lambda L: np.abs(L) - 1.0)
        L = self.channels(found)[np.arange(len(found)), channel] if len(found) else np.zeros(0)
        return gain, float(np.degrees(np.pi - np.abs(np.angle(L)).max(initial=0.0)))

    def values(self, band_hz: float, from_hz: float, wanted: set[str] | None = None) -> dict[str, float]:
        """Values in the units of limits; `band_hz` is the edge of the bands, `from_hz` where torque's begins."""
        out: dict[str, float] = {"minimum decay rate": self.decay}
        if not self.stable:
            return out
        ratios = -self.s.real / np.abs(self.s)
        out["damping"] = float(ratios.min())
        nyquist = np.pi / self.one.period

        def asked(*names: str) -> bool:
            return wanted is None or bool(wanted & set(names))

        w = self.grid(1e-3 * self.slow, nyquist * (1.0 - 1e-9))
        P, K = self.parts(w)
        p = self.p
        S, S_in = np.linalg.inv(np.eye(p) - P @ K), np.linalg.inv(np.eye(p) - K @ P)
        norm = lambda X: np.linalg.norm(X, 2, axis=(1, 2))  # noqa: E731
        size = np.maximum(norm(S), norm(S_in))
        above = np.flatnonzero(size >= np.sqrt(0.5))
        out |= {
            "disk margin": 1.0 / max(norm(S - 0.5 * np.eye(p)).max(), norm(S_in - 0.5 * np.eye(p)).max()),
            "sensitivity peak": size.max(),
            "complementary sensitivity peak": max(norm(np.eye(p) - S).max(), norm(np.eye(p) - S_in).max()),
            "bandwidth": w[above[0]] / (2.0 * np.pi) if above.size else np.inf,
            "tracking error": norm(S)[w <= 2.0 * np.pi * band_hz].max(),
        }
        if asked("gain margin", "phase margin"):
            out["gain margin"], out["phase margin"] = self.margins(w)
        if asked("steady-state error", "ramp error"):
            slow = np.array([3e-3, 6e-3]) * self.slow
            P0, K0 = self.parts(slow)
            left = np.abs(np.diagonal(np.linalg.inv(np.eye(p) - P0 @ K0), axis1=1, axis2=2))
            growing = left[1] > 1.5 * left[0]
            # |S|² is even in the frequency: two values give the limit without the term of second order.
            limit = np.sqrt(np.maximum(4.0 * left[0] ** 2 - left[1] ** 2, 0.0) / 3.0)
            out["steady-state error"] = float(np.where(growing, 0.0, limit).max())
            out["ramp error"] = float(left[0].max() / slow[0]) if growing.all() else np.inf
        band = self.grid(3e-2 * self.slow, 2.0 * np.pi * band_hz)
        # A disturbance may be faster than what is sampled.
        high = self.grid(3e-2 * self.slow, 3.0 * nyquist)
        images = [abs(2.0 * nyquist + sign * w[w > 1e-3 * nyquist]) for sign in (-1.0, 1.0)]
        high = np.unique(np.concatenate([high, *images]))
        high = high[(np.abs(high - 2.0 * nyquist) > 1e-3 * nyquist) & (high < 3.0 * nyquist)]
        reading = "angle" if self.one.pointing else "rate"
        if asked(f"{reading} from Omega"):
            slow, slower = self.of_rate.sure_gain(band[0] * np.array([1.0, 0.1]))
            worst = float(self.of_rate.sure_gain(high).max())
            out[f"{reading} from Omega"] = np.inf if slower > max(5.0 * slow, 1e-2 * worst) else worst
        if asked(f"{reading} from torque"):
            out[f"{reading} from torque"] = float(self.of_torque.sure_gain(high).max())
        if asked("attenuation of base motion"):
            slow, slower = self.of_sight.sure_gain(band[0] * np.array([1.0, 0.1]))
            worst = self.of_sight.sure_gain(band).max()
            worst = np.inf if slower > max(5.0 * slow, 1e-2 * worst) else worst
            out["attenuation of base motion"] = float(-20.0 * np.log10(worst))
        if asked("torque at full Omega over its limit"):
            torque = self.grid(2.0 * np.pi * from_hz, 2.0 * np.pi * band_hz)
            rows = np.linalg.norm(0.3 * self.of_rate.torques(torque), axis=2)
            out["torque at full Omega over its limit"] = float(rows.max())
        if asked("overshoot", "settling time"):
            out |= dict(zip(("overshoot", "settling time"), self.steps(), strict=True))
        if asked("torque noise, rms"):
            out["torque noise, rms"] = self.torque_noise(w)
        return out

    def torque_noise(self, w) -> float:
        """From frequencies of a period of an hour on."""
        T = self.one.period
        first = 1.0 / (np.pi * 3600.0)
        low = np.geomspace(first, w[0], 2000)[:-1] if w[0] > first and self.free else np.zeros(0)
        fine = np.concatenate([low, w[w >= first] if self.free else w])
        P, K = self.parts(fine)
        S_in = np.linalg.inv(np.eye(self.p) - K @ P)
        density = np.sum(np.abs(S_in @ K * self.noise) ** 2, axis=2)
        if self.one.fed:
            base = 6e-5 * np.sqrt(0.5 / T) if not self.one.bandwidth_hz else self.noise[0]
            density = density + np.sum(np.abs(S_in @ self.of_rate.controller(fine)[:, :, self.p :]) ** 2, 2) * base**2
        rms = np.sqrt(T / np.pi * np.trapezoid(density, fine, axis=0))
        return float(rms.max())

    def steps(self) -> tuple[float, float]:
        """Overshoot and settling time of the readings' own signals behind a step of each command, u = K (y - r)."""
        found = [self._step(k) for k in range(self.p)]
        return max(one[0] for one in found), max(one[1] for one in found)

    def _step(self, channel: int) -> tuple[float, float]:
        loop, T, fine = self.loop, self.one.period, 24
        _, B, C, N, m = loop._discrete()
        late, p, (_, B_K, _, D_K) = int(loop.late.max()), self.p, self.own
        whole, u = loop.closed()
        size = len(whole)
        drive = np.zeros(size)
        drive[:N] -= (B @ D_K)[:, channel]
        drive[N + late * p :] -= B_K[:, channel]
        # The signal between samples, from the state and the torques there.
        n = len(loop.A)
        M = np.zeros((n + 2 * m, n + 2 * m))
        M[:n, :n], M[:n, n : n + m] = loop.A, loop.B_u
        slow = loop.lag[0] > 0.0
        if slow:
            M[n : n + m, n : n + m], M[n : n + m, n + m :] = -np.eye(m) / loop.lag[0], np.eye(m) / loop.lag[0]
        wholes, part = divmod(loop.delay / T + 1e-12, 1.0)
        wholes = int(wholes)
        early = [expm(M * min(j / fine, part) * T) for j in range(fine)]
        after = [expm(M * max(j / fine - part, 0.0) * T) for j in range(fine)]

        def between(x: np.ndarray) -> np.ndarray:
            """Signal (fine,) after a sample with state x."""
            new = x[N - m : N] if wholes else u @ x - D_K[:, channel]
            out = []
            for j in range(fine):
                at = early[j] @ x[: n + 2 * m]
                if j / fine >= part:
                    at = after[j] @ np.concatenate([at[: n + m] if slow else np.append(at[:n], new), new])
                out.append(loop.C_y[channel] @ at[:n])
            return np.array(out)

        # Every sample while there are few; then at samples further and further apart, by powers of the loop.
        first = 3000
        X = np.zeros((first, size))
        for k in range(1, first):
            X[k] = whole @ X[k - 1] + drive
        seen = C[channel] @ X[:, :N].T
        end = int(np.ceil(14.0 / (self.decay * T)))
        number, times, values, states = first - 1, list(range(first)), list(seen), list(X)
        power = np.block([[whole, drive[:, None]], [np.zeros((1, size)), np.ones((1, 1))]])
        x, stride = np.append(X[-1], 1.0), 1
        while number < end:
            if len(times) % 1500 == 0:
                power, stride = power @ power, 2 * stride
            x, number = power @ x, number + stride
            times.append(number)
            values.append(C[channel] @ x[:N])
            states.append(x[:size])
        values = np.array(values)

        def samples(start: int, count: int) -> tuple[np.ndarray, np.ndarray]:
            """All instants of `count` samples from the last one known up to the number `start`."""
            k = int(np.searchsorted(times, start, side="right")) - 1
            x, at, t, y = states[k], times[k], [], []
            while at < start + count:
                if at >= start:
                    y.append(between(x))
                    t.append(T * (at + np.arange(fine) / fine))
                x, at = whole @ x + drive, at + 1
            return np.concatenate(t), np.concatenate(y)

        top = int(times[int(np.argmax(values))])
        t, y = samples(max(top - 12, 0), 24)
        over = max(float(y.max() - 1.0), 0.0)
        outside = np.flatnonzero(np.abs(values - 1.0) > 0.02)
        if abs(values[-1] - 1.0) > 0.0199:
            return over, np.inf
        last = times[outside[-1]] if outside.size else 0
        follow = times[min(outside[-1] + 1, len(times) - 1)] if outside.size else 0
        t, y = samples(max(last - 12, 0), follow - last + 24)
        far = np.flatnonzero(np.abs(y - 1.0) > 0.02)
        return over, float(t[far[-1]]) if far.size else 0.0
