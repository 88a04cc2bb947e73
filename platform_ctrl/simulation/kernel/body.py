"""What the kernel knows of a plant, and where in the memory it stands.

Every gimbal's body has axes of its own in which its joint's axis is e_z; the root has those of the file. At zero angle
they differ from the parent's by a constant rotation, for joints along coordinate axes (nearly all) a mere renaming of
the axes, done by the slots that are read.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.frozen import FloatArray

# Columns of `Links.tree`, a row for each gimbal, parents first: gimbal, parent's body; which component of a vector in
# the parent's axes is x, y, z here; which slots of the parent's inertia are xx, yy, zz, xy, xz, yz here (from XX on);
# whether instead the rotation in `Links.turn` leads from the parent's axes to these.
GIMBAL, PARENT, X, Y, Z, XX, YY, ZZ, XY, XZ, YZ, SKEW = range(12)

# Slots of a body's constants: inertia of the carrier with its rotors as in `pack`; unbalance m r.
BODY, UNBALANCE = 9, 6
# Slots of a joint's constants.
STIFFNESS, PRELOAD, VISCOUS, COULOMB, BREAKAWAY, PER_COULOMB_RATE, PER_STRIBECK_RATE, CAGE, JOINT = (
    0, 1, 2, 3, 5, 7, 8, 9, 13,
)  # fmt: skip
# Slots of a servo rotor's constants: spin axis in the carrier's axes; then these.
C, SPIN, GAIN, INTEGRAL, TORQUE_LIMIT, SERVO = 3, 4, 5, 6, 7, 8
# Slots of an erection's constants: sensing axis; then these.
ERECTION_GAIN, ERECTION_LIMIT, ERECTION = 3, 4, 5

# Slots of a body in the workspace: cosine and sine of its joint; rate; velocity product of the acceleration (x, y);
# moment; articulated inertia xx, yy, zz, xy, xz, yz; U/D and u/D of the joint; acceleration; specific force.
COS, SIN, RATE, PRODUCT, MOMENT, INERTIA, GAIN_X, GAIN_Y, DRIVE, ACCELERATION, FORCE, LOCKED, WORK = (
    0, 1, 2, 5, 7, 10, 16, 17, 18, 19, 22, 25, 26,
)  # fmt: skip


class Links(NamedTuple):
    """How the bodies hang together, the same in every scenario."""

    tree: NDArray[np.int64]  # (n, 12)
    turn: FloatArray  # (n, 3, 3)
    servo_carrier: NDArray[np.int64]  # (m,): body
    erection: NDArray[np.int64]  # (e, 2): order of the torqued gimbal, sensing body


class At(NamedTuple):
    """Counts, switches, and first slots.

    `yes` and `no` are True and False for functions of the kernel: numba compiles one anew for every literal.
    """

    yes: bool
    no: bool
    n: int  # gimbals
    servos: int
    size: int  # of the state
    joints: int  # whether springs, friction or cages act at all
    dry: int  # whether there is dry friction
    cages: int
    weight: int  # whether specific force and unbalance or erections act
    course: int  # whether rotors' momenta change with time
    body: int
    joint: int
    servo: int
    erection: int
    work: int
    stages: int  # three states: at, derivative, total
    state: int
    surroundings: int  # three blocks: at the beginning, middle and end of a step
    block: int  # slots of a block
    end: int


# A block of the surroundings: [M, Q], Omega, specific force, and of every body its rotors' momentum and how fast that
# changes. Where the parts begin:


def slots_of_block(n: int) -> int:
    """Return the number of slots of a block of the surroundings of n gimbals."""
    return 7 * n + 15
