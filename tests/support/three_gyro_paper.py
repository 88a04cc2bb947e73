"""Magnus's (20) to (27) for the three-gyro platform, corrected as docs/theory/the-paper.md says, in SymPy.

The one table of them: tests/mechanics/test_the_paper.py holds it against the energy of the nine bodies, and
tests/mechanics/test_symbolic.py holds the package against it. Symbols have the names that
`platform_ctrl.equations` gives them.
"""

import dataclasses

import numpy as np
import sympy

from platform_ctrl import Platform, read_platform

J1, J2, J3, J12, J13, J23, J4, J5, J7, J9, J10 = sympy.symbols("J1 J2 J3 J12 J13 J23 J4 J5 J7 J9 J10")
C6, C8, C11, L6, L8, L11 = sympy.symbols("C6 C8 C11 L6 L8 L11")
a4, b5, b7, a9, b10 = ANGLES = sympy.symbols("alpha4 beta5 beta7 alpha9 beta10")
a4d, b5d, b7d, a9d, b10d = sympy.symbols("alpha4_dot beta5_dot beta7_dot alpha9_dot beta10_dot")
a4dd, b5dd, b7dd, a9dd, b10dd = sympy.symbols("alpha4_ddot beta5_ddot beta7_ddot alpha9_ddot beta10_ddot")
W1, W2, W3 = sympy.symbols("Omega1:4")
D1, D2, D3 = sympy.symbols("Omega1_dot Omega2_dot Omega3_dot")
Q4, Q5, Q7, Q9, Q10 = sympy.symbols("Q4 Q5 Q7 Q9 Q10")

HALF = sympy.Rational(1, 2)

# (20), (22)
VELOCITY = sympy.Matrix([W1, W2, W3, a4d, b5d, b7d, a9d, b10d])
MOMENTA = sympy.Matrix([L6, L8, L11])

# (21), B_A to second order
B0 = sympy.Matrix([[1, 0, 0, 0, 0, 0, 0, 0], [-1, 0, 0, 0, 0, 0, 0, 0], [0, 1, 0, 0, 0, 0, 0, 0]])
B_A = sympy.Matrix(
    [
        [-HALF * (a4**2 + b5**2), b5, -a4, b5, 0, 0, 0, 0],
        [+HALF * (a4**2 + b7**2), b7, a4, b7, 0, 0, 0, 0],
        [-a9, -HALF * (a9**2 + b10**2), b10, 0, 0, 0, b10, 0],
    ]
)

# (23), zero order
A = sympy.Matrix(
    [
        [J1, J12, J13, 0, 0, 0, 0, J10],
        [J12, J2, J23, J4, 0, 0, 0, 0],
        [J13, J23, J3, 0, J5, -J7, J9, 0],
        [0, J4, 0, J4, 0, 0, 0, 0],
        [0, 0, J5, 0, J5, 0, 0, 0],
        [0, 0, -J7, 0, 0, J7, 0, 0],
        [0, 0, J9, 0, 0, 0, J9, 0],
        [J10, 0, 0, 0, 0, 0, 0, J10],
    ]
)


def _square(entries):
    out = sympy.zeros(8, 8)
    for (i, j), entry in entries.items():
        out[i, j] = entry
    return out


# (24), first order
_UPPER = _square(
    {
        (0, 0): C6 + C8,
        (0, 1): C6 * b5 - C8 * b7 - C11 * a9,
        (0, 2): -(C6 + C8) * a4,
        (0, 3): C6 * b5 - C8 * b7,
        (1, 1): C11,
        (1, 2): C11 * b10,
        (1, 6): C11 * b10,
    }
)
BTA_RB = _UPPER + _UPPER.T - sympy.diag(*_UPPER.diagonal())

# (25) from A constant and (24)
_N = _square(
    {
        (0, 3): -(C6 + C8) * W3,
        (2, 3): -(C6 + C8) * W1,
        (0, 4): C6 * (W2 + a4d),
        (1, 4): C6 * W1,
        (3, 4): C6 * W1,
        (0, 5): -C8 * (W2 + a4d),
        (1, 5): -C8 * W1,
        (3, 5): -C8 * W1,
        (0, 6): -C11 * W2,
        (1, 6): -C11 * W1,
        (1, 7): C11 * (W3 + a9d),
        (2, 7): C11 * W2,
        (6, 7): C11 * W2,
    }
)
G_A = _N - HALF * _N.T

# (26), first order
G_R = sympy.Matrix(
    [
        [0, 0, 0, (L8 - L6) * a4, -L6 * b5, L8 * b7, -L11, 0],
        [0, 0, 0, 0, L6, L8, -L11 * a9, -L11 * b10],
        [0, 0, 0, L8 - L6, 0, 0, 0, L11],
        [(L6 - L8) * a4, 0, L6 - L8, 0, L6, L8, 0, 0],
        [L6 * b5, -L6, 0, -L6, 0, 0, 0, 0],
        [-L8 * b7, -L8, 0, -L8, 0, 0, 0, 0],
        [L11, L11 * a9, 0, 0, 0, 0, 0, L11],
        [0, L11 * b10, -L11, 0, 0, 0, -L11, 0],
    ]
)

# (27): left and right side by gimbal
ROWS = {
    "4": (
        J4 * a4dd + L6 * b5d + L8 * b7d + (L6 - L8) * W1 * a4 + C6 * D1 * b5 - C8 * D1 * b7,
        Q4 - J4 * D2 - (L6 - L8) * W3,
    ),
    "5": (J5 * b5dd - L6 * a4d + L6 * W1 * b5, Q5 - J5 * D3 + L6 * W2),
    "7": (J7 * b7dd - L8 * a4d - L8 * W1 * b7, Q7 + J7 * D3 + L8 * W2),
    "9": (J9 * a9dd + L11 * b10d + L11 * W2 * a9 + C11 * D2 * b10, Q9 - J9 * D3 - L11 * W1),
    "10": (J10 * b10dd - L11 * a9d + L11 * W2 * b10, Q10 - J10 * D1 + L11 * W3),
}
TORQUES = (Q4, Q5, Q7, Q9, Q10)

# What (27) would be with every term linear in the angles, at any rate Omega(t): left side by gimbal, all but Q, as
# {variable: coefficient}. K are inertias with C about axes 1, 2, 3 of all that turns with a gimbal.
J4_1, J4_3, J5_1, J5_2, J7_1, J7_2, J9_1, J9_2, J10_2, J10_3 = sympy.symbols(
    "J4_1 J4_3 J5_1 J5_2 J7_1 J7_2 J9_1 J9_2 J10_2 J10_3"
)
_K5 = (J5_1 + C6, J5_2, J5)
_K7 = (J7_1 + C8, J7_2, J7)
_K10 = (J10, J10_2 + C11, J10_3)
_K4 = (J4_1 + C6 + C8, J4, J4_3)
_K9 = (J9_1, J9_2 + C11, J9)
EXACT_ROWS = {
    "4": {
        1: _K4[1] * D2 + (L6 - L8) * W3 + (_K4[0] - _K4[2]) * W1 * W3,
        a4dd: _K4[1],
        b5d: L6 + (_K5[0] - _K5[1] - _K5[2]) * W1,
        b7d: L8 + (-_K7[0] + _K7[1] + _K7[2]) * W1,
        a4: (L6 - L8) * W1 + (_K4[0] - _K4[2]) * (W1**2 - W3**2),
        b5: (_K5[0] - _K5[1]) * (D1 + W2 * W3),
        b7: (-_K7[0] + _K7[1]) * (D1 + W2 * W3),
    },
    "5": {
        1: _K5[2] * D3 - L6 * W2 + (-_K5[0] + _K5[1]) * W1 * W2,
        b5dd: _K5[2],
        a4d: -L6 + (-_K5[0] + _K5[1] + _K5[2]) * W1,
        a4: _K5[2] * D1 + (_K5[0] - _K5[1]) * W2 * W3,
        b5: L6 * W1 + (_K5[0] - _K5[1]) * (W1**2 - W2**2),
    },
    "7": {
        1: -_K7[2] * D3 - L8 * W2 + (_K7[0] - _K7[1]) * W1 * W2,
        b7dd: _K7[2],
        a4d: -L8 + (_K7[0] - _K7[1] - _K7[2]) * W1,
        a4: -_K7[2] * D1 + (-_K7[0] + _K7[1]) * W2 * W3,
        b7: -L8 * W1 + (_K7[0] - _K7[1]) * (W1**2 - W2**2),
    },
    "9": {
        1: _K9[2] * D3 + L11 * W1 + (-_K9[0] + _K9[1]) * W1 * W2,
        a9dd: _K9[2],
        b10d: L11 + (-_K10[0] + _K10[1] - _K10[2]) * W2,
        a9: L11 * W2 + (_K9[0] - _K9[1]) * (W1**2 - W2**2),
        b10: (_K10[1] - _K10[2]) * (D2 + W1 * W3),
    },
    "10": {
        1: _K10[0] * D1 - L11 * W3 + (-_K10[1] + _K10[2]) * W2 * W3,
        b10dd: _K10[0],
        a9d: -L11 + (_K10[0] - _K10[1] + _K10[2]) * W2,
        a9: _K10[0] * D2 + (_K10[1] - _K10[2]) * W1 * W3,
        b10: L11 * W2 + (_K10[1] - _K10[2]) * (W2**2 - W3**2),
    },
}


def gimbal_rows(terms: str) -> sympy.Matrix:
    """Rows 4, 5, 7, 9, 10 with everything on the left but Q: the paper's (27), or every term linear in the angles."""
    if terms == "exact":
        return sympy.Matrix([sum(variable * c for variable, c in row.items()) for row in EXACT_ROWS.values()])
    return sympy.Matrix([left - right + Q for (left, right), Q in zip(ROWS.values(), TORQUES, strict=True)])


def unequal_platform() -> Platform:
    """The three-gyro platform with inertias and angular momenta that are all different."""
    platform = read_platform("three_gyro_platform")
    inertias = [(0.9, 0.7, 0.8), (0.31, 0.25, 0.28), (0.29, 0.27, 0.24), (0.55, 0.6, 0.52), (0.33, 0.36, 0.21)]
    rotors = [(0.11, 0.08, 21.0), (0.12, 0.07, 17.0), (0.13, 0.09, 13.0)]
    return dataclasses.replace(
        platform,
        root_inertia=np.array([[12.0, 0.3, -0.2], [0.3, 10.0, 0.4], [-0.2, 0.4, 14.0]]),
        gimbals=tuple(
            dataclasses.replace(g, inertia=np.diag(own)) for g, own in zip(platform.gimbals, inertias, strict=True)
        ),
        rotors=tuple(
            dataclasses.replace(r, axial_inertia=C, transverse_inertia=A, angular_momentum=L)
            for r, (C, A, L) in zip(platform.rotors, rotors, strict=True)
        ),
    )


def numbers(platform: Platform) -> dict[str, float]:
    """The numbers of the symbols of `gimbal_rows` for a platform of this form."""
    carried = [np.diag(g.inertia) for g in platform.gimbals]
    out = {}
    for rotor, body in zip(platform.rotors, (1, 2, 4), strict=True):
        carried[body] = carried[body] + rotor.transverse_inertia * (1.0 - np.abs(rotor.axis))
        out |= {f"C{rotor.name}": rotor.axial_inertia, f"L{rotor.name}": rotor.angular_momentum}
    carried[0], carried[3] = carried[0] + carried[1] + carried[2], carried[3] + carried[4]
    # J without an axis is the one about the gimbal's own.
    for gimbal, inertia in zip(platform.gimbals, carried, strict=True):
        own = int(np.argmax(np.abs(gimbal.axis)))
        out |= {f"J{gimbal.name}" + (f"_{k + 1}" if k != own else ""): float(x) for k, x in enumerate(inertia)}
    return out
