"""The kinetic energy of Magnus's platform, body by body from rotation matrices, to second order in the angles.

Nothing of the package is used: this is the ground on which the paper's equations and ours are judged.
"""

from sympy import QQ, ring

ANGLES = ("a4", "b5", "b7", "a9", "b10")
RATES = ("O1", "O2", "O3", "a4d", "b5d", "b7d", "a9d", "b10d")
ACCELERATIONS = ("O1d", "O2d", "O3d", "a4dd", "b5dd", "b7dd", "a9dd", "b10dd")
SPINS = ("f6", "f8", "f11")
MOMENTA = ("L6", "L8", "L11")
AXIAL = ("C6", "C8", "C11")
TRANSVERSE = ("A6", "A8", "A11")
ROOT = ("P1", "P2", "P3", "P12", "P13", "P23")
BODIES = tuple(f"I{k}_{axis}" for k in (4, 5, 7, 9, 10) for axis in (1, 2, 3))
NAMES = (*ANGLES, *RATES, *ACCELERATIONS, *SPINS, *MOMENTA, *AXIAL, *TRANSVERSE, *ROOT, *BODIES)

R, *_gens = ring(NAMES, QQ)
S = dict(zip(NAMES, _gens, strict=True))
HALF = QQ(1, 2)


def degree(monomial, names=ANGLES):
    return sum(monomial[NAMES.index(name)] for name in names)


def kept(polynomial, order, names=ANGLES):
    """Terms up to `order` in `names`."""
    return R.from_dict({m: c for m, c in polynomial.items() if degree(m, names) <= order})


def times(x, y):
    return kept(x * y, 2)


def turn(axis, angle, vector):
    """Components in axes that are turned by `angle` about coordinate axis 1, 2 or 3, to second order."""
    i, j = {1: (1, 2), 2: (2, 0), 3: (0, 1)}[axis]
    out = list(vector)
    cosine = 1 - HALF * angle**2
    out[i] = times(cosine, vector[i]) + times(angle, vector[j])
    out[j] = times(cosine, vector[j]) - times(angle, vector[i])
    return out


def plus(vector, axis, rate):
    out = list(vector)
    out[axis - 1] += rate
    return out


Omega = [S["O1"], S["O2"], S["O3"]]
W4 = plus(turn(2, S["a4"], Omega), 2, S["a4d"])
W5 = plus(turn(3, S["b5"], W4), 3, S["b5d"])
W7 = plus(turn(3, -S["b7"], W4), 3, -S["b7d"])
W9 = plus(turn(3, S["a9"], Omega), 3, S["a9d"])
W10 = plus(turn(1, S["b10"], W9), 1, S["b10d"])

# What the carriers add to the rotors' rates, B u of (2): spin axes +1, -1, +2 of their housings.
CARRIED = (W5[0], -W7[0], W10[1])
_across = ((W5, (1, 2)), (W7, (1, 2)), (W10, (0, 2)))


def square(x):
    return times(x, x)


# Everything but the rotors about their own axes: the first part of (1).
T_A = HALF * sum(S[f"P{k + 1}"] * square(Omega[k]) for k in range(3))
T_A += S["P12"] * Omega[0] * Omega[1] + S["P13"] * Omega[0] * Omega[2] + S["P23"] * Omega[1] * Omega[2]
for _body, _rate in ((4, W4), (5, W5), (7, W7), (9, W9), (10, W10)):
    T_A += HALF * sum(S[f"I{_body}_{k + 1}"] * square(_rate[k]) for k in range(3))
for _inertia, (_rate, _axes) in zip(TRANSVERSE, _across, strict=True):
    T_A += HALF * sum(S[_inertia] * square(_rate[k]) for k in _axes)

# (1) with (2); and the parts of (9).
OMEGA_ROTORS = tuple(S[f] + carried for f, carried in zip(SPINS, CARRIED, strict=True))
T = T_A + HALF * sum(S[c] * square(w) for c, w in zip(AXIAL, OMEGA_ROTORS, strict=True))
T2 = T_A + HALF * sum(S[c] * square(w) for c, w in zip(AXIAL, CARRIED, strict=True))
T1 = sum(S[momentum] * w for momentum, w in zip(MOMENTA, CARRIED, strict=True))


def over_time(polynomial):
    """d/dt by the chain rule; exact to first order in the angles."""
    out = R.zero
    for angle, rate in zip(ANGLES, RATES[3:], strict=True):
        out += polynomial.diff(S[angle]) * S[rate]
    for rate, acceleration in zip(RATES, ACCELERATIONS, strict=True):
        out += polynomial.diff(S[rate]) * S[acceleration]
    return out


def gimbal_row(k, energy):
    """(10) for gimbal k of ANGLES, to first order in the angles."""
    row = over_time(energy.diff(S[RATES[3 + k]])) - energy.diff(S[ANGLES[k]])
    return kept(row, 1)


def root_rows(energy):
    """The root's rows after Boltzmann and Hamel."""
    h = [energy.diff(S[name]) for name in RATES[:3]]
    cross = [Omega[1] * h[2] - Omega[2] * h[1], Omega[2] * h[0] - Omega[0] * h[2], Omega[0] * h[1] - Omega[1] * h[0]]
    return [kept(over_time(part) + turned, 1) for part, turned in zip(h, cross, strict=True)]


def mass_matrix(energy, order=1):
    """∂²T/∂u∂u."""
    return [[kept(energy.diff(S[i]).diff(S[j]), order) for j in RATES] for i in RATES]


def direction_matrix(order=2):
    """B (3): what each velocity adds to each rotor's rate."""
    return [[kept(carried.diff(S[rate]), order) for rate in RATES] for carried in CARRIED]
