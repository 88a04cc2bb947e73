"""Several controllers as one: in the order of their list, a later one may take an earlier one's torque as its input.

Anti-windup by back-calculation, x⁺ = A x + B y + E (limited u − u): with V the states that integrate (A V = V Λ) and C
the outputs' share in them,

    E = V (Λ − (1 − T/Tt) I) (C V)^+,

so that while torques are at their limits these states follow the share that remains of them, with the time constant Tt;
the other poles stay. Tt is the integral time: where the controller's integral action becomes its proportional one
(Åström, Hägglund, Advanced PID Control, 2006, section 3.5).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.analysis.system import ComplexArray, StateSpace, System, block, scaled, state_scaling
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError
from platform_ctrl.plant.platform import is_rate

# Ending of the name of a command: what a loop holds a reading at.
COMMAND = "_command"


class MultiRate(NamedTuple):
    """Controllers at several rates as one, from p readings to m torques.

    Controllers computed at every sample are one system, `fast`; its inputs are the readings, then the signals that
    slower ones hold, its outputs the torques, then the inputs of the slower ones, both in their order.
    """

    fast: System  # dt: the sample period, s
    slow: tuple[System, ...] = ()  # dt: whole numbers of sample periods, s

    @property
    def every(self) -> tuple[int, ...]:
        """At every how many samples each of the slower ones is computed."""
        return tuple(round(K.dt / self.fast.dt) for K in self.slow)

    @property
    def cycle(self) -> int:
        """Samples after which the order of computations repeats."""
        return math.lcm(1, *self.every)

    @property
    def held(self) -> int:
        """Number of signals that the slower ones hold."""
        return sum(len(K.C) for K in self.slow)

    @property
    def read(self) -> int:
        """Number of signals that the slower ones read."""
        return sum(K.B.shape[1] for K in self.slow)

    def at(self, sample: int) -> System:
        """Return the controller of one sample. States: those of `fast`, then of each slower one with its outputs."""
        if not self.slow:
            return self.fast
        from scipy.linalg import block_diag

        own = [_held(K, sample % n == 0) for K, n in zip(self.slow, self.every, strict=True)]
        A, B, C, D = (block_diag(np.zeros((0, 0)), *(K[k] for K in own)) for k in range(4))
        p, m = self.fast.B.shape[1] - self.held, len(self.fast.C) - self.read
        joined = self.fast.feedback(System(A, B, C, D), range(p, p + self.held), range(m, m + self.read))
        return joined.part(slice(self.held, self.held + m), slice(p))


class Modulator(NamedTuple):
    """The map from the readings y of R components to the controls u of each, at N frequencies.

    Signals that slower loops hold have S components; those of the h signals that component r sees are `place[r]`.
    """

    own: ComplexArray  # (N, R, m, p): from y of a component to u of the same one, by the loops at every sample
    held: ComplexArray  # (N, R, m, h): from what the slower loops hold to u of a component
    heard: ComplexArray  # (N, R, S, p): from y of a component to what the slower loops hold
    place: NDArray[np.intp]  # (R, h)

    def of(self, k: int, component: int, y: ComplexArray) -> ComplexArray:
        """Return u of all components (R, m, c) at one of the frequencies, of y (p, c) of one component."""
        out = self.held[k] @ (self.heard[k, component] @ y)[self.place]
        out[component] += self.own[k, component] @ y
        return np.asarray(out)


def interconnected(
    controllers: Sequence[StateSpace], inputs: Sequence[str], outputs: Sequence[str], period: float
) -> System:
    """Return one controller from `inputs` (pick-offs, rate sensors) to `outputs` (torquers).

    All have the same period; the controllers come in the order in which they are computed. Their inputs are names among
    `inputs`, outputs of an earlier controller (that step's value), or NAME + ``_command`` of a reading, zero where
    nothing gives it. Their outputs are names among `outputs` or inputs of a later controller; no name twice, but a
    command that is among `inputs` adds to what an outer loop commands. An output that no controller sets is zero.
    """
    for k, system in enumerate(controllers):
        if not math.isclose(system.dt or 0.0, period, rel_tol=1e-9):
            raise ArgumentError(f"{_where(k, system)}: dt must be the sample period {period:.6g} s, got {system.dt!r}")
    return interconnected_by_sample(controllers, inputs, outputs, period)[0]


def interconnected_by_sample(
    controllers: Sequence[StateSpace],
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
    limited: Collection[str] = (),
) -> list[System]:
    """Return the matrices of `interconnected` at every sample until they repeat.

    A controller whose dt is n periods is computed at every n-th sample, the first included; its outputs are held in
    between, in states of their own. The same matrices are the same object. Where outputs are `limited` the excess of
    every output, limited − commanded, is a further input, which acts on the states: see `back_calculation`.
    """
    rates = interconnected_at_rates(controllers, inputs, outputs, period, limited)
    made: dict[tuple[bool, ...], System] = {}
    out = []
    for sample in range(rates.cycle):
        due = tuple(sample % n == 0 for n in rates.every)
        if due not in made:
            made[due] = rates.at(sample)
        out.append(made[due])
    return out


def interconnected_at_rates(
    controllers: Sequence[StateSpace],
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
    limited: Collection[str] = (),
) -> MultiRate:
    """Return the result of `interconnected_by_sample` before it is split into the samples of the cycle."""
    parts, slow = [], []
    for k, system in enumerate(controllers):
        K = System.of(system, _where(k, system))
        n = max(round(K.dt / period), 1)
        if not math.isclose(K.dt, n * period, rel_tol=1e-9):
            words = f"dt must be the sample period {period:.6g} s or a whole number of them, got {K.dt:.6g} s"
            raise ArgumentError(f"{_where(k, system)}: {words}")
        slow += [k] if n > 1 else []
        if limited:
            # The excesses of limited outputs are further inputs.
            cut = [name in limited for name in system.output_labels]
            E = back_calculation(K, cut).gain[:, cut]
            K = K._replace(B=np.hstack([K.B, E]), D=np.hstack([K.D, np.zeros((len(K.C), E.shape[1]))]))
        parts.append(K)
    fast = _joined(parts, controllers, inputs, outputs, period, slow, limited)
    return MultiRate(fast, tuple(parts[k] for k in slow))


def _held(K: System, due: bool) -> System:
    """Return a controller with its last outputs as further states: as it is computed, or holding them."""
    n, (p, m) = len(K.A), K.D.shape
    if not due:
        return System(np.eye(n + p), np.zeros((n + p, m)), np.eye(n + p)[n:], np.zeros((p, m)), K.dt)
    A = np.block([[K.A, np.zeros((n, p))], [K.C, np.zeros((p, p))]])
    return System(A, np.vstack([K.B, K.D]), np.hstack([K.C, np.zeros((p, p))]), K.D, K.dt)


def _joined(
    parts: Sequence[System],
    controllers: Sequence[StateSpace],
    inputs: Sequence[str],
    outputs: Sequence[str],
    period: float,
    apart: Collection[int],
    limited: Collection[str],
) -> System:
    """Join the matrices of controllers by the names of their signals.

    For controllers that are kept `apart` the result has inputs for their outputs, behind the others, and outputs for
    their inputs. Where any outputs are `limited` the parts have inputs for their excesses.
    """
    states = sum(len(K.A) for k, K in enumerate(parts) if k not in apart)
    given = states + len(inputs) + (len(outputs) if limited else 0)
    size = given + sum(len(parts[k].C) for k in apart)
    # Every signal is a row over [all controllers' states, what is measured, what those kept apart give].
    rows: dict[str, FloatArray] = {name: np.eye(size)[states + k] for k, name in enumerate(inputs)}
    excess = {name: np.eye(size)[states + len(inputs) + k] for k, name in enumerate(outputs) if name in limited}
    taken_apart = [np.zeros((0, size))]
    made: dict[str, str] = {}
    taken: set[str] = set()
    after = np.zeros((states, size))
    place = 0
    for k, (K, system) in enumerate(zip(parts, controllers, strict=True)):
        where = _where(k, system)
        # Nobody commands these readings: they are held at zero.
        rows |= {name: np.zeros(size) for name in system.input_labels if name not in rows and name.endswith(COMMAND)}
        _expect_inputs(where, system.input_labels, rows)
        taken |= set(system.input_labels)
        beyond = [excess[name] for name in system.output_labels if name in excess]
        seen = np.array([*(rows[name] for name in system.input_labels), *beyond]).reshape(-1, size)
        if k in apart:
            taken_apart.append(seen)
            u = np.eye(size)[given : given + len(K.C)]
            given += len(K.C)
        else:
            own = slice(place, place + len(K.A))
            after[own] = K.B @ seen
            after[own, own] += K.A
            u = K.D @ seen
            u[:, own] += K.C
            place = own.stop
        for name, row in zip(system.output_labels, u, strict=True):
            if name in inputs and name.endswith(COMMAND) and name not in made:
                row = row + rows[name]
            elif name in rows:
                raise ArgumentError(f"{where}: output {name!r} exists already; give it another name")
            rows[name] = row
            made[name] = where
    for name, where in made.items():
        if name not in outputs and name not in taken:
            words = f"output {name!r} is neither a torquer nor an input of a later controller"
            raise ArgumentError(f"{where}: {words}; use one of {', '.join(outputs)}")
    final = np.array([rows[name] if name in made else np.zeros(size) for name in outputs]).reshape(len(outputs), size)
    final = np.vstack([final, *taken_apart])
    return System(after[:, :states], after[:, states:], final[:, :states], final[:, states:], period)


def _expect_inputs(where: str, inputs: Sequence[str], known: Collection[str]) -> None:
    unknown = [name for name in inputs if name not in known]
    if unknown and is_rate(unknown[0]):
        raise ArgumentError(
            f"{where}: input {unknown[0]!r} is a rate that no sensor measures; add a rate sensor to the plant"
        )
    if unknown:
        words = f"input {unknown[0]!r} is neither a pick-off nor an output of an earlier controller"
        raise ArgumentError(f"{where}: {words}; use one of {', '.join(known) or 'none'}")


def _where(k: int, system: StateSpace) -> str:
    return f"controller {k + 1} ({getattr(system, 'name', '')!r})"


# A state integrates if it decays by less than this share in a sample.
_DECAY = 1e-3
# Least and largest T/Tt.
_SLOWEST, _FASTEST = 1e-4, 0.1
# Integrals that share outputs to a part smaller than this of the largest cannot be distinguished by them.
_BLIND = 1e-9


@value
class BackCalculation:
    """The anti-windup of a controller."""

    gain: FloatArray  # (states, outputs): E; zero: none
    integrals: int = 0  # States that integrate
    seen: int = 0  # How many of these the limited outputs determine
    time_constant: float = 0.0  # Tt, s
    radius: float = 0.0  # Of the slowest pole with all limited outputs at their limits


def back_calculation(K: System, limited: Sequence[bool]) -> BackCalculation:
    """Return the anti-windup of a sampled controller some of whose outputs are `limited`."""
    from scipy.linalg import schur

    limits = np.array(limited, dtype=np.bool_)[:, None]
    none = np.zeros((len(K.A), len(limits)))
    A, B, C = scaled(K.A, K.B, K.C)
    t, Z, k = (
        schur(A, output="real", sort=lambda re, im=0.0: abs(complex(re, im)) > 1.0 - _DECAY) if len(A) else (A, A, 0)
    )
    if not k or not limits.any():
        return BackCalculation(gain=none, integrals=k)
    V, own = state_scaling(K.A, K.B, K.C)[:, None] * Z[:, :k], t[:k, :k]
    # Outputs without limit have no excess. The limits' sizes do not matter: simulated plants may differ in them.
    seen = np.where(limits, K.C @ V, 0.0)
    sizes = np.linalg.norm(seen, axis=0)
    sizes[sizes == 0.0] = 1.0
    share = _integral_share(t, Z.T @ B, C @ Z, K.D, k)
    gain = V @ ((own - (1.0 - share) * np.eye(k)) / sizes) @ np.linalg.pinv(seen / sizes, rcond=_BLIND)
    gain[np.abs(gain) < 1e-12 * np.abs(gain).max(axis=1, keepdims=True, initial=0.0)] = 0.0
    rank = int(np.linalg.matrix_rank(seen / sizes, tol=_BLIND * np.sqrt(k)))
    radius = float(np.abs(np.linalg.eigvals(K.A - gain @ np.where(limits, K.C, 0.0))).max())
    return BackCalculation(gain=gain, integrals=k, seen=rank, time_constant=K.dt / share, radius=radius)


def _integral_share(t: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, k: int) -> float:
    """Return T/Tt for the integral time: gain of the integrals in one sample over that of the rest at z = 1."""
    from scipy.linalg import solve_sylvester

    if k < len(t):
        # The other states, decoupled from the integrating ones, have a gain at z = 1.
        X = solve_sylvester(t[:k, :k], -t[k:, k:], -t[:k, k:])
        B, C = B.copy(), C.copy()
        B[:k] -= X @ B[k:]
        C[:, k:] += C[:, :k] @ X
        D = D + C[:, k:] @ np.linalg.solve(np.eye(len(t) - k) - t[k:, k:], B[k:])
    slow, proportional = (float(np.linalg.norm(part, 2)) for part in (C[:, :k] @ B[:k], D))
    return float(np.clip(slow / proportional if proportional > 0.0 else _FASTEST, _SLOWEST, _FASTEST))


def at_several_rates(controller: MultiRate, R: int, w: FloatArray, P: ComplexArray, late: ComplexArray) -> Modulator:
    """Return M of controllers at several rates over R samples, at components w (N, R), P_d and reading delays.

    An integrator makes some directions of K infinite at zero and not others: controllers stay state equations.
    """
    p, m = P.shape[-2:]
    period = controller.fast.dt
    D = controller.fast.D
    A, B, C = scaled(*controller.fast[:3])
    n = len(A)
    # The loops at every sample, closed: states and controls of each component, from readings and from what is held.
    z, path = np.exp(1j * period * w)[..., None, None], late[..., None] * P
    loop = block([[z * np.eye(n) - A, -B[:, :p] @ path], [-C[:m], np.eye(m) - D[:m, :p] @ path]])
    of_y = late[..., None, :]
    found: ComplexArray = np.linalg.solve(loop, block([[B[:, :p] * of_y, B[:, p:]], [D[:m, :p] * of_y, D[:m, p:]]]))
    u = found[..., n:, :]
    # Inputs of the slower controllers from y and from held signals; each component has a share of them.
    e = C[m:] @ found[..., :n, :] + D[m:, :p] @ path @ u
    e[..., :p] += D[m:, :p] * of_y
    e[..., p:] += D[m:, p:]
    every = np.repeat(controller.every, [len(K.C) for K in controller.slow]).astype(np.float64)
    turned = 0.5 * period * w[..., None]
    share = np.exp(-1j * turned * (every - 1.0)) * np.sinc(turned * every / np.pi) / np.sinc(turned / np.pi)
    e[..., p:] *= share[..., None, :]
    heard, place = _slower(controller, w, e)
    return Modulator(u[..., :p], u[..., p:] * share[..., None, :], heard, place)


def _slower(controller: MultiRate, w: FloatArray, e: ComplexArray) -> tuple[ComplexArray, NDArray[np.intp]]:
    """Return the held signals of the slower loops from y of each component (N, R, S, p), and its places (R, h) in them.

    They read e (N, R, read, p + h): components that a slow loop cannot tell apart add up.
    """
    from scipy.linalg import block_diag

    N, R, _, width = e.shape
    h, read = controller.held, controller.read
    p = width - h
    # Number of components that each loop can tell apart: first those of one loop, then those of the next.
    apart = [R // n for n in controller.every]
    own = [(*scaled(*K[:3]), K.D) for K in controller.slow]
    A, B, C, D = (
        block_diag(np.zeros((0, 0)), *(np.kron(np.eye(L), K[k]) for K, L in zip(own, apart, strict=True)))
        for k in range(4)
    )
    turns = [
        np.repeat(np.exp(1j * n * controller.fast.dt * w[:, :L]), len(K[0]), axis=1)
        for K, L, n in zip(own, apart, controller.every, strict=True)
    ]
    z = np.concatenate([np.zeros((N, 0)), *turns], axis=1)
    read_at = _places([K[1].shape[1] for K in own], apart, R)
    held_at = _places([len(K[2]) for K in own], apart, R)
    alike = math.lcm(1, *apart)
    summed = e[..., p:].reshape(N, R // alike, alike, read, h).sum(axis=1)
    around = np.zeros((N, B.shape[1], len(C)), dtype=np.complex128)
    for k in range(alike):
        around[:, read_at[k][:, None], held_at[k]] += summed[:, k]
    n, S = len(A), len(C)
    loop = block([[z[:, :, None] * np.eye(n) - A, -B @ around], [-C, np.eye(S) - D @ around]])
    set_by = np.linalg.solve(loop, np.vstack([B, D]).astype(np.complex128))[:, n:]
    heard = np.zeros((N, R, S, p), dtype=np.complex128)
    for k in range(alike):
        heard[:, k::alike] = set_by[:, None, :, read_at[k]] @ e[:, k::alike, :, :p]
    return heard, held_at


def _places(sizes: list[int], apart: list[int], R: int) -> NDArray[np.intp]:
    """Return the places (R, sum of sizes) of each component's signals among those of all that loops tell apart."""
    r = np.arange(R)[:, None]
    first = np.cumsum([0, *(size * L for size, L in zip(sizes, apart, strict=True))])
    parts = [at + r % L * size + np.arange(size) for at, size, L in zip(first[:-1], sizes, apart, strict=True)]
    return np.hstack([np.zeros((R, 0), dtype=np.intp), *parts]).astype(np.intp)
