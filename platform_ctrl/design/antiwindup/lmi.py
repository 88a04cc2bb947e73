"""Invariant ellipsoids of a limited loop, and anti-windup gains with them, by matrix inequalities.

With φ = u − limited u the generalised sector condition holds for every G: where |(K − G) η| is within what the limits
leave, φ' T (φ − G η) <= 0 for diagonal T > 0 (Gomes da Silva and Tarbouriech, IEEE Trans. Autom. Control 50, 2005).
With V = η' Q⁻¹ η, S = T⁻¹, Y = G Q, X = E S the ellipsoid V <= 1 is invariant for all |b| <= 1 if

    | (1−α) Q   −Y'            0     Q A'          |
    | −Y        2 S            0     −(B S + R X)' |  > 0,     and the rows of K Q − Y are in the polar.
    | 0         0              α     B_w'          |
    | A Q       −(B S + R X)   B_w   Q             |

Every state inside returns to equilibrium once Omega is constant: V falls to 1 − α of its value in a sample at least.
Where K η itself is within the limits φ is zero, and a Lyapunov equation gives Q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from platform_ctrl.analysis.certificates.certificate import Verification
from platform_ctrl.analysis.norms import stationary_covariance
from platform_ctrl.analysis.poles import poles, spectral_radius
from platform_ctrl.common.text import at_least
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.antiwindup.loop import LimitedLoop
from platform_ctrl.errors import DesignError, InfeasibleError, NotCertifiedError, UnscalableError

# Slack of the matrix inequality in the solver's units, for the proof.
_SLACK = 1e-7
# Relative losses against the best objective, tried in turn, that make the inequalities of the final solution strict.
_OBJECTIVE_LOSSES = (1e-3, 3e-3, 1e-2)
# Share of the torques' limits, and of the states' sizes, by which ellipsoids are widened in every direction.
_WIDENING = 3e-5
# Samples over which the first estimate of a direction's multiple is computed.
_SAMPLES_AHEAD = 200
# Rounds that raise Omega to what the last ellipsoid allows.
_ROUNDS = 3
_CURE = "give a smaller Omega, a slower rise, larger limits, or a loop with more damping"


@value
class InvariantEllipsoid:
    """The ellipsoid η' Q⁻¹ η <= 1 of a limited loop: states that start in it stay in it.

    Attributes
    ----------
    loop
        The loop.
    Omega
        Largest rate of the manoeuvres, rad/s.
    alpha
        V falls at least by this share in a sample once Omega is constant.
    gain : (n_K, m)
        Anti-windup gain E, in the units of the system matrices.
    Q, Y, S
        The matrices of the inequality, shapes ((n, n), (m, n), (m,)); Y and S in units of what Omega leaves of each
        limit. With ``saturates`` false Y and S are zero: the torques stay below their limits.
    saturates
        Whether torques may exceed their limits.
    """

    loop: LimitedLoop
    Omega: float
    alpha: float
    gain: FloatArray
    Q: FloatArray
    Y: FloatArray
    S: FloatArray
    saturates: bool

    def level(self, state: FloatArray) -> FloatArray:
        """Return V of states (..., n): at most 1 inside."""
        out: FloatArray = np.einsum("...i,...i->...", state, np.linalg.solve(self.Q, state.T).T)
        return out

    def reach(self, direction: FloatArray) -> float:
        """Return the largest multiple of a state that lies inside."""
        return float(1.0 / math.sqrt(self.level(direction)))

    def verify(self, precision: int = 128) -> Verification:
        """Prove in ball arithmetic that the ellipsoid is invariant, for the loop's matrices as they are."""
        import flint

        from platform_ctrl.analysis.certificates.intervals import positive_definite

        statement = (
            f"a state of order {len(self.Q)} inside the ellipsoid stays there while |Omega| <= "
            f"{at_least(self.Omega, 6)} rad/s"
        )
        margin = 1.0
        with flint.ctx.workprec(precision):
            for matrix, name in self._inequalities():
                definite, found = positive_definite(matrix)
                if not definite:
                    reason = (
                        f"{name} is not {'distinguishable from singular' if definite is None else 'positive definite'}"
                    )
                    return Verification(
                        proved=False, statement=statement, reason=reason, margin=0.0, precision=precision
                    )
                margin = min(margin, found)
        reason = f"Q, the invariance and the limits are positive definite ({precision} bits)"
        return Verification(proved=True, statement=statement, reason=reason, margin=margin, precision=precision)

    def _inequalities(self) -> list[tuple[Any, str]]:
        """Return what has to be positive definite, in balls, with names."""
        import flint

        from platform_ctrl.analysis.certificates.intervals import balls, blocks

        loop, one = self.loop, flint.arb(1)
        m = len(loop.limits)
        room = [flint.arb(float(x)) - abs(flint.arb(float(y))) * flint.arb(self.Omega) for x, y in zip(
            [*loop.limits, *loop.stops], [*loop.u_steady, *loop.angle_steady], strict=True)]  # fmt: skip
        Q, A, Y = balls(self.Q), balls(loop.A), balls(self.Y)
        alpha = flint.arb(self.alpha)
        moved = A * Q
        b = flint.arb(self.Omega) * balls(loop.B_w)
        corner = flint.arb_mat([[alpha]])
        none, across = balls(np.zeros((len(self.Q), 1))), balls(np.zeros((m, 1)))
        diagonal = flint.arb_mat([[room[i] if i == j else 0 for j in range(m)] for i in range(m)])
        if self.saturates:
            S = balls(np.diag(self.S))
            late = -1 * ((balls(loop.B) + balls(loop.R) * balls(self.gain)) * diagonal * S)
            kept = blocks(
                [
                    [(one - alpha) * Q, -1 * Y.transpose(), none, moved.transpose()],
                    [-1 * Y, 2 * S, across, late.transpose()],
                    [none.transpose(), across.transpose(), corner, b.transpose()],
                    [moved, late, b, Q],
                ]
            )
        else:
            kept = blocks(
                [
                    [(one - alpha) * Q, none, moved.transpose()],
                    [none.transpose(), corner, b.transpose()],
                    [moved, b, Q],
                ]
            )
        out = [(Q, "Q"), (kept, "the invariance")]
        commanded = balls(loop.K) * Q
        for i, name in enumerate(loop.controls):
            row = flint.arb_mat([commanded.tolist()[i]]) - room[i] * flint.arb_mat([Y.tolist()[i]])
            out.append((blocks([[Q, row.transpose()], [row, flint.arb_mat([[room[i] ** 2]])]]), f"the limit of {name}"))
        seen = balls(loop.C)
        for j, name in enumerate(loop.measurements):
            if math.isfinite(loop.stops[j]):
                row = flint.arb_mat([seen.tolist()[j]])
                inside = flint.arb_mat([[room[m + j] ** 2]]) - row * Q * row.transpose()
                out.append((inside, f"the stop of {name}"))
        return out


def rooms(loop: LimitedLoop, Omega: float) -> tuple[FloatArray, FloatArray]:
    """Return what a constant Omega leaves of the torques' limits and of the stops; positive below `static_Omega`."""
    return loop.limits - np.abs(loop.u_steady) * Omega, loop.stops - np.abs(loop.angle_steady) * Omega


def below_the_limits(loop: LimitedLoop, alpha: float) -> InvariantEllipsoid:
    """Return the ellipsoid of the largest Omega whose torques provably stay below their limits, at a decay `alpha`."""
    Q = _least(loop, alpha)
    squares = [np.einsum("ij,jk,ik->i", rows, Q, rows) for rows in (loop.K, loop.C)]
    if not all(np.all(square >= 0.0) for square in squares):
        raise NotCertifiedError(
            f"largest Omega: no invariant ellipsoid was found at a decay of {alpha:.3g} 1/s: the loop is too near to "
            "instability",
            loop,
        )
    u, y = np.sqrt(squares[0]) + np.abs(loop.u_steady), np.sqrt(squares[1]) + np.abs(loop.angle_steady)
    # What Omega does not move never reaches its limit.
    with np.errstate(divide="ignore"):
        Omega = float(min((loop.limits / u).min(), (loop.stops / y).min())) * (1.0 - 1e-9)
    m, n = loop.K.shape
    return InvariantEllipsoid(
        loop=loop,
        Omega=Omega,
        alpha=alpha,
        gain=np.zeros((loop.R.shape[1], m)),
        Q=_symmetric(Q * Omega**2),
        Y=np.zeros((m, n)),
        S=np.zeros(m),
        saturates=False,
    )


def minimum_decay_rate(loop: LimitedLoop) -> float:
    """Return the largest α for which the linear loop has an invariant ellipsoid: 1 − ρ²."""
    return 1.0 - float(spectral_radius(poles(loop.A))) ** 2


def _least(loop: LimitedLoop, alpha: float, Omega: float = 1.0, extra: FloatArray | None = None) -> FloatArray:
    """Return Q = A Q A'/(1−α) + B_w B_w' Omega²/α (+ extra), slightly larger and non-singular."""
    root = math.sqrt(1.0 - alpha)
    driven = [Omega * loop.B_w * (1.0 + 1e-7) / math.sqrt(alpha)]
    if extra is not None:
        driven.append(extra)
    # A torque far below the limits, and a change of every state far below the effect of such torques.
    torque = loop.B * loop.limits
    size = np.sqrt(np.diag(stationary_covariance(loop.A / root, torque)))
    size = np.where(size > 0.0, size, max(Omega, 1.0) * loop.jerk)
    driven += [_WIDENING * torque, _WIDENING * np.diag(size)]
    return _symmetric(stationary_covariance(loop.A / root, np.hstack(driven)))


def _symmetric(matrix: FloatArray) -> FloatArray:
    out: FloatArray = 0.5 * (matrix + matrix.T)
    return out


def widest(
    loop: LimitedLoop,
    Omega: float,
    alpha: float,
    *,
    directions: FloatArray | None = None,
    gain: FloatArray | None = None,
    time_limit: float = 60.0,
) -> InvariantEllipsoid:
    """Return the ellipsoid of the largest Omega, or of the largest multiple of `directions`, with anti-windup gain.

    `Omega` is the largest rate, below `LimitedLoop.static_Omega`; without `directions`, (n, k), it is where the search
    of a larger one starts. `alpha` is below `minimum_decay_rate`. A given `gain`, (n_K, m), is kept (zeros: none).
    """
    problem = _Problem(loop, Omega, alpha, directions)
    best = problem.solve(gain, None, time_limit)
    if directions is None:
        most = problem.larger_Omega(best)
        for _ in range(_ROUNDS):
            again = _Problem(loop, most, alpha, None)
            try:
                found = again.solve(gain, None, time_limit)
            except UnscalableError:
                break
            reached = again.larger_Omega(found)
            if not reached > most * (1.0 + 1e-5):
                break
            most, best = reached, found
        Omega = most
    E = best.gain if gain is None else gain
    # Once more with the gain fixed and a slightly worse objective: as far from the boundary as possible.
    failure: DesignError
    for loss in _OBJECTIVE_LOSSES:
        try:
            if directions is None:
                problem = _Problem(loop, Omega * (1.0 - loss), alpha, None)
            return problem.ellipsoid(problem.solve(E, best.objective * (1.0 + loss), time_limit), E)
        except (InfeasibleError, NotCertifiedError, UnscalableError) as error:
            failure = error
    raise failure


@value
class _Solution:
    """An answer of the solver, in its units; `objective` is the used share of the limits, or 1/(multiple)²."""

    Q: FloatArray
    Y: FloatArray
    S: FloatArray
    gain: FloatArray
    objective: float


class _Problem:
    """The inequalities in states T η̂ with T T' near the solution, torques in units of what Omega leaves of them."""

    def __init__(self, loop: LimitedLoop, Omega: float, alpha: float, directions: FloatArray | None) -> None:
        self.loop, self.Omega, self.alpha = loop, Omega, alpha
        self.room, stops = rooms(loop, Omega)
        if not (np.all(self.room > 0.0) and np.all(stops > 0.0)):
            raise InfeasibleError(
                f"anti-windup: |Omega| must be below {loop.static_Omega:.6g} rad/s, which takes all of a limit in "
                f"equilibrium, got {Omega:.6g}",
                loop,
            )
        into = loop.B * self.room
        extra = [0.3 * into]
        self.directions = None
        if directions is not None:
            # A first estimate of the multiple: where the first torque reaches its limit.
            state, share = directions, np.zeros(1)
            for _ in range(_SAMPLES_AHEAD):
                share = np.maximum(share, np.max(np.abs(loop.K @ state) / self.room[:, None], initial=0.0))
                share = np.maximum(share, np.max(np.abs(loop.C @ state) / stops[:, None], initial=0.0))
                state = loop.A @ state
            self.unit = 1.0 / float(share[0]) if share[0] > 0.0 else 1.0
            extra.append(directions * self.unit)
        self.T = np.linalg.cholesky(_least(loop, alpha, Omega, np.hstack(extra)))
        back = np.linalg.inv(self.T)
        self.A, self.B_w, self.B = back @ loop.A @ self.T, Omega * (back @ loop.B_w), back @ into
        self.K, self.C = loop.K @ self.T / self.room[:, None], loop.C @ self.T / stops[:, None]
        R = back @ loop.R
        self.R_unit = np.linalg.norm(R, axis=0) if R.size else np.zeros(0)
        self.R_unit = np.where(self.R_unit > 0.0, self.R_unit, 1.0)
        self.R = R / self.R_unit
        if directions is not None:
            self.directions = back @ directions * self.unit

    def solve(self, gain: FloatArray | None, objective: float | None, time_limit: float) -> _Solution:  # noqa: PLR0915 - one linear matrix inequality
        """Minimise the objective; where one is given maximise the slack at it."""
        from platform_ctrl.design.lmi.conic import Solver, cp

        n, m = self.B.shape
        order = self.R.shape[1]
        Q, S, Y = cp.Variable((n, n), symmetric=True), cp.Variable(m), cp.Variable((m, n))
        used, slack = cp.Variable(), cp.Variable()
        variables = [Q, S, Y, used, slack]
        late = self.B @ cp.diag(S)
        X = None
        if gain is None and order:
            X = cp.Variable((order, m))
            variables.append(X)
            late = late + self.R @ X
        elif gain is not None and order:
            late = (self.B + self.R @ (gain * self.room * self.R_unit[:, None])) @ cp.diag(S)
        row, across = np.zeros((1, n)), np.zeros((1, m))
        moved = Q @ self.A.T
        kept = cp.bmat(
            [
                [(1.0 - self.alpha) * Q, -Y.T, row.T, moved],
                [-Y, 2.0 * cp.diag(S), across.T, -late.T],
                [row, across, self.alpha * np.eye(1), self.B_w.T],
                [moved.T, -late, self.B_w, Q],
            ]
        )
        constraints = [kept >> slack * np.eye(2 * n + m + 1), slack <= S, slack <= 1e-3]
        for k in range(m):
            over = self.K[k : k + 1] @ Q - Y[k : k + 1]
            corner = cp.reshape(used, (1, 1), order="C")
            constraints.append(cp.bmat([[Q, over.T], [over, corner]]) >> slack * np.eye(n + 1))
        for c in self.C[np.any(self.C, axis=1)]:
            spent = c @ Q @ c
            constraints.append(spent <= used)
        goal = used
        if self.directions is not None:
            reach = cp.Variable()
            variables.append(reach)
            constraints.append(used <= 1.0 - 1e-9)
            for d in self.directions.T:
                corner = cp.reshape(reach, (1, 1), order="C")
                constraints.append(cp.bmat([[corner, d[None]], [d[:, None], Q]]) >> 0)
            goal = reach
        if objective is None:
            constraints.append(slack >= _SLACK)
            aim = cp.Minimize(goal)
        else:
            constraints.append(goal <= (1.0 - 1e-9 if self.directions is None else objective))
            aim = cp.Maximize(slack)
        solver = Solver(where="anti-windup", cure=_CURE, time_limit=time_limit, P=self.loop)
        solver.solve(cp.Problem(aim, constraints), tuple(variables), "the invariant ellipsoid", decompose=False)
        E = np.zeros((order, m)) if gain is None else gain
        if X is not None:
            E = X.value / S.value / self.R_unit[:, None] / self.room
        return _Solution(
            Q=_symmetric(np.asarray(Q.value)),
            Y=np.asarray(Y.value),
            S=np.asarray(S.value),
            gain=np.asarray(E),
            objective=float(goal.value),
        )

    def ellipsoid(self, found: _Solution, gain: FloatArray) -> InvariantEllipsoid:
        """Return what was found, in SI units, proved."""
        out = InvariantEllipsoid(
            loop=self.loop,
            Omega=self.Omega,
            alpha=self.alpha,
            gain=gain,
            Q=_symmetric(self.T @ found.Q @ self.T.T),
            Y=found.Y @ self.T.T,
            S=found.S,
            saturates=True,
        )
        shown = out.verify()
        if not shown.proved:
            raise NotCertifiedError(f"anti-windup: the ellipsoid was not proved: {shown.reason}; {_CURE}", self.loop)
        return out

    def larger_Omega(self, found: _Solution) -> float:
        """Return the largest Omega for which the ellipsoid, enlarged with it, is invariant."""
        loop = self.loop
        over = self.K @ found.Q - found.Y
        used_u = self.room * np.sqrt(np.einsum("ij,ji->i", over, np.linalg.solve(found.Q, over.T)))
        used_y = np.sqrt(np.einsum("ij,jk,ik->i", self.C, found.Q, self.C))
        used_y = used_y * rooms(loop, self.Omega)[1] if np.all(np.isfinite(loop.stops)) else np.zeros(len(used_y))
        u = (used_u / self.Omega + np.abs(loop.u_steady)) / loop.limits
        y = (used_y / self.Omega + np.abs(loop.angle_steady)) / loop.stops
        return float(1.0 / max(u.max(), y.max()))
