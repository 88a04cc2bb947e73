"""The kinetic energy of Magnus's platform, body by body from rotation matrices, to second order in the angles.

Nothing of the package is used: this is the ground on which the paper's equations and ours are judged. What moves has
the names of tests/support/three_gyro_paper.py; every body has inertias of its own, of which the paper's J are sums.
"""

from sympy import QQ, ring, sympify

ANGLES = ("alpha4", "beta5", "beta7", "alpha9", "beta10")
OMEGA = ("Omega1", "Omega2", "Omega3")
RATES = (*OMEGA, *(f"{name}_dot" for name in ANGLES))
ACCELERATIONS = (*(f"{name}_dot" for name in OMEGA), *(f"{name}_ddot" for name in ANGLES))
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


def kept(terms, order, names=ANGLES):
    """Terms up to `order` in `names`."""
    return R.from_dict({m: c for m, c in terms.items() if degree(m, names) <= order})


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


Omega = [S[name] for name in OMEGA]
W4 = plus(turn(2, S["alpha4"], Omega), 2, S["alpha4_dot"])
W5 = plus(turn(3, S["beta5"], W4), 3, S["beta5_dot"])
W7 = plus(turn(3, -S["beta7"], W4), 3, -S["beta7_dot"])
W9 = plus(turn(3, S["alpha9"], Omega), 3, S["alpha9_dot"])
W10 = plus(turn(1, S["beta10"], W9), 1, S["beta10_dot"])

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

# The paper's J, and J<gimbal>_<axis> beside them, without C: what turns with a gimbal at zero angles.
COMPOSITES = {
    "J1": S["P1"] + sum(S[f"I{k}_1"] for k in (4, 5, 7, 9, 10)) + S["A11"],
    "J2": S["P2"] + sum(S[f"I{k}_2"] for k in (4, 5, 7, 9, 10)) + S["A6"] + S["A8"],
    "J3": S["P3"] + sum(S[f"I{k}_3"] for k in (4, 5, 7, 9, 10)) + S["A6"] + S["A8"] + S["A11"],
    "J12": S["P12"],
    "J13": S["P13"],
    "J23": S["P23"],
    "J4": S["I4_2"] + S["I5_2"] + S["A6"] + S["I7_2"] + S["A8"],
    "J5": S["I5_3"] + S["A6"],
    "J7": S["I7_3"] + S["A8"],
    "J9": S["I9_3"] + S["I10_3"] + S["A11"],
    "J10": S["I10_1"] + S["A11"],
    "J4_1": S["I4_1"] + S["I5_1"] + S["I7_1"],
    "J4_3": S["I4_3"] + S["I5_3"] + S["A6"] + S["I7_3"] + S["A8"],
    "J5_1": S["I5_1"],
    "J5_2": S["I5_2"] + S["A6"],
    "J7_1": S["I7_1"],
    "J7_2": S["I7_2"] + S["A8"],
    "J9_1": S["I9_1"] + S["I10_1"] + S["A11"],
    "J9_2": S["I9_2"] + S["I10_2"],
    "J10_2": S["I10_2"],
    "J10_3": S["I10_3"] + S["A11"],
}
_IN_BODIES = {symbol: composite.as_expr() for symbol, composite in COMPOSITES.items()}


def polynomial(expression):
    """A SymPy expression of the paper in terms of the bodies."""
    return R.from_expr(sympify(expression).subs(_IN_BODIES))


def polynomials(matrix):
    return [[polynomial(matrix[i, j]) for j in range(matrix.cols)] for i in range(matrix.rows)]


# (1) with (2); and the parts of (9).
OMEGA_ROTORS = tuple(S[f] + carried for f, carried in zip(SPINS, CARRIED, strict=True))
T = T_A + HALF * sum(S[c] * square(w) for c, w in zip(AXIAL, OMEGA_ROTORS, strict=True))
T2 = T_A + HALF * sum(S[c] * square(w) for c, w in zip(AXIAL, CARRIED, strict=True))
T1 = sum(S[momentum] * w for momentum, w in zip(MOMENTA, CARRIED, strict=True))


def over_time(energy):
    """d/dt by the chain rule; exact to first order in the angles."""
    out = R.zero
    for angle, rate in zip(ANGLES, RATES[3:], strict=True):
        out += energy.diff(S[angle]) * S[rate]
    for rate, acceleration in zip(RATES, ACCELERATIONS, strict=True):
        out += energy.diff(S[rate]) * S[acceleration]
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
