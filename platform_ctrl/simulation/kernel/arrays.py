"""The data of a scenario, and their slots in the memory, behind those of the plant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.values import FloatArray

# Effects of a fault on a part. Actions on one part follow each other in this order.
RUN_DOWN, RUN_UP, RIPPLE, TORQUER_WEAK, TORQUER_STUCK, TORQUER_DEAD = range(6)
PICKOFF_DRIFT, PICKOFF_DROPOUT, PICKOFF_STUCK, PICKOFF_DEAD, OVERRUN, CONTACT = range(6, 12)
# The same, in the same order, by the names that `platform_ctrl.job.faults.FaultKind.action` gives.
_NAMES = """run-down, run-up, ripple, share of torque, constant torque, no torque, drift, lost readings, last reading,
    no reading, missed samples, impulse"""
ACTIONS = {name.strip(): action for action, name in enumerate(_NAMES.split(","))}

# Columns of `Shared.sensors`, a row for each sensor: begin and end of its terms; row of its low-pass, or -1; samples
# that it is late, and where in `Layout.late` the last ones are; samples from one reading to the next.
BEGIN_TERMS, END_TERMS, FILTERED, LATE, KEPT, EVERY = range(6)
# Slots of a sensor: rms of a sample, quantisation, scale, bias; the last reading, and how much of it is a fault's. Of a
# command: its path; what the controllers get of it.
RMS, QUANTISATION, SENSOR_SCALE, BIAS, LAST, FAILED, SENSOR = 0, 1, 2, 3, 4, 5, 6
PATH = 0
# Slots of a low-pass: x of the next sample is TRANSITION x + BEFORE u + NOW u of the next sample; u; x.
TRANSITION, BEFORE, NOW, INPUT, LAGGING, LOWPASS = 0, 4, 6, 8, 9, 11
# Slots of a torquer: limit, how far it slews at once and in half a substep of each segment, decay of the lag over half
# a substep of each segment; what it works towards, where it has slewed to, torque; share of what it slews in half a
# substep of each segment by which the lag is behind at its end; constant torque that adds to the commands; largest
# torque that a motor's supply allows at rest, and by how much less that is at a rate; N m for a unit of its command.
LIMIT, AT_ONCE, SLEW, DECAY, HELD, SLEWED, TORQUE, BEHIND, EQUILIBRIUM, STALL, BACK_EMF, PER_COMMAND, TORQUER = (
    0, 1, 2, 4, 6, 7, 8, 9, 11, 12, 13, 14, 15,
)  # fmt: skip
# Slots of a drive: friction that is fed forward, 1 over the rate from which on all of it acts.
DRIVE_FRICTION, PER_DRIVE_RATE, DRIVEN = 0, 1, 2
# Slots in which readings are turned to joint axes: J, row by row; the readings.
JACOBIAN, TO_TURN, TURNED = 0, 9, 12
# Slots of a stop: low, high, restitution; whether the gimbal lies on it; when and at which rate it last bounced off.
LOW, HIGH, RESTITUTION, TOUCHING, WHEN, AWAY, STOP = 0, 1, 2, 3, 4, 5, 6
# Slots of a fault: begin, end, its two numbers; what is stuck.
BEGIN, UNTIL, FIRST, SECOND, STUCK, FAULT = 0, 1, 2, 3, 4, 5
# Slots of a rotor whose speed is not steady: L s in the carrier's axes (servo: nominal spin); share of it that is there
# at the end of a step, and at the end of the step before.
SHARE, LAST_SHARE, ROTOR = 3, 4, 5
# Slots of a line of a vibration: amplitude; cosine and sine of its turn in half a substep of each segment; and of its
# phase.
AMPLITUDE, TURN, PHASE, LINE = 0, 1, 5, 7
# Slots of the platform's motion: half-cosine's rate vector, rise, hold; scale of the time table; how long lines rise.
RISE, HOLD, SCALE, FADE, PROFILE = 3, 4, 5, 6, 7


class Slots:
    """The slots of a memory, taken one part behind the other."""

    def __init__(self, end: int = 0) -> None:
        self.end = end

    def __call__(self, count: int) -> int:
        """Take slots, and return the first of them."""
        self.end += count
        return self.end - count


class Shared(NamedTuple):
    """The arrays that all scenarios of a batch share."""

    # (ny, 6), and behind the sensors the rates and angles of the line of sight. Every array of this tuple makes calls
    # of compiled functions slower by some percent of a run.
    sensors: NDArray[np.int64]
    signals: NDArray[
        np.int64
    ]  # (terms,): index into [q, Omega, rates, bodies' rates, bodies' rotations, η and η̇ in turn]
    # (terms,): weights. Then of every resolver |det J| at which its gain is limited, what each of its sensors of the
    # root shows, and of each other the axis and those of the gimbals on its path.
    weights: FloatArray
    targets: NDArray[np.int64]  # (nu,): index into [M, Q]
    faults: NDArray[np.int64]  # (nf, 3): kind; sensor, torquer, gimbal or row of `rotors`; channel of its draws
    rotors: NDArray[np.int64]  # (nr, 2): body; servo rotor or -1
    # (nl,): component 0 to 2 of Omega, 3 to 5 of the specific force, 6 + k: torque on gimbal k; n + 6 more: phase given
    lines: NDArray[np.int64]
    # (nx + nu + nd + 1 + nc + nd + ...,): rows of the controllers [A B; C D] and of the rates of the nd drives,
    # stored without zeros; the reading of every command; of each drive its torquer; of every resolver the number of
    # its sensors and of those of the root, these, of each other sensor and number of gimbals on its path, of each
    # of these the column or -1, the encoder or -1. Columns of B and D: readings, commands, excesses of torques.
    # Where some controllers are computed at every n-th sample there follow the rows [A B; C D] of other samples,
    # and of every sample of `Layout.cycle` where its rows begin.
    first: NDArray[np.int64]
    column: NDArray[np.int64]
    # Then of every sample from the first of a call on the nc commands, and what the controllers get of them.
    number: FloatArray
    knots: FloatArray  # (k,): of the time table of Omega or, with a free root, of M, and of torques on the gimbals
    pieces: FloatArray  # (k - 1, 3, 4), or with torques on the gimbals (k - 1, 3 + n, 4)
    period: float


class Layout(NamedTuple):
    """Counts, switches, and first slots behind the plant's."""

    samples: int
    whole: int  # full periods from a sample to its torque
    before: int  # substeps of a period before and after the command changes
    after: int
    states: int  # of the controllers
    cycle: int  # samples until they repeat; 1: all are computed at every sample
    stops: int  # whether any gimbal has stops
    profile: int  # whether a half-cosine is simulated
    fade: int  # whether lines rise from zero
    sensors: int  # rows of `Shared.sensors` that are sensors
    readings: int  # sensors, and resolved readings behind them
    commands: int
    drives: int
    resolvers: int
    start: int  # state at t = 0, v holding the rates
    steady: int  # block of surroundings: what does not change
    rate: int
    segments: int  # substeps of the two segments
    settle: int  # samples before the mean and rms begin
    # In slots like theirs are behind them resolved readings: BIAS (what errors of the sensors do to them) and LAST are
    # used; commands: PATH and LAST; excesses of torques: LAST.
    sensor: int
    lowpass: int
    torquer: int
    drive: int
    stop: int
    fault: int
    rotor: int
    line: int
    given: int  # end of what the host gives
    controller: int  # states, then next states
    command: int  # the present one
    ring: int  # limited commands of the last `whole` + 2 samples
    late: int  # what sensors that are late have yet to say
    turned: int
    velocity: int  # rates at the sample
    sight: int  # rates, and angles, of the line of sight at the sample
    turns: int  # every body's rotation since t = 0; inertial axes in its axes, and at t = 0; 0: nothing reads it
    table: int  # three rows of the time table's torque
    pushed: int  # rows of torques on the gimbals from outside, one for each block of the surroundings
    alive: int
    random: int
    begun: int  # the state at the begin of a step
    metrics: int  # see `widths_of_metrics`
    following: int  # of every command the largest |reading − command| of settled samples
    end: int


def widths_of_metrics(n: int, nu: int, sight: int) -> tuple[int, ...]:
    """Return how many of each metric come out, of n gimbals, nu torquers and `sight` outputs of the line of sight.

    Largest |q|, |rotation vector|, share of limits; saturated samples; contacts; samples; largest |gimbal rate|;
    samples that are settled; of a plant with a line of sight, of [Omega, line of sight] the mean over them and the sum
    of squares about it. Behind them are those of `Layout.following`.
    """
    spread = 3 + sight if sight else 0
    return n, 3, nu, nu, n, 1, n, 1, spread, spread


# Columns of `Links.tree`, a row for each gimbal, parents first: gimbal, parent's body; which component of a vector in
# the parent's axes is x, y, z here; which slots of the parent's inertia are xx, yy, zz, xy, xz, yz here (from XX on);
# whether instead the rotation in `Links.turn` leads from the parent's axes to these; the parent's row, or -1.
GIMBAL, PARENT, X, Y, Z, XX, YY, ZZ, XY, XZ, YZ, SKEW, UP = range(13)

# Slots of a body's constants: inertia of the carrier with its rotors as in `pack`; unbalance m r.
BODY, UNBALANCE = 9, 6
# Slots of a body's constants where masses lie anywhere: its mass and first moment; its joint in the parent's axes; sums
# of N J and N² J of the geared rotors at its joint. Then inertias of bodies are about their joints.
MASS, FIRST_MOMENT, ARM, GEARED, PLACE = 0, 1, 4, 7, 9
# Slots of such a body in the workspace: velocity of its joint; mass, first moment and unbalance of its subtree;
# momentum, or force; acceleration of its joint.
SPEED, WHOLE, SUM, LOPSIDED, LINEAR, FELT, MOVING = 0, 3, 4, 7, 10, 13, 16
# Slots of a joint's constants.
STIFFNESS, PRELOAD, VISCOUS, COULOMB, BREAKAWAY, PER_COULOMB_RATE, PER_STRIBECK_RATE, CAGE, LAW, BRISTLE, JOINT = (
    0, 1, 2, 3, 5, 7, 8, 9, 13, 14, 16,
)  # fmt: skip
# The dry friction's law in LAW; `At.dry` has a bit for each that there is. BRISTLE: stiffness, damping.
SMOOTH, STICKING, BRISTLES, ELASTOPLASTIC = 0, 1, 2, 3
# Slots of a joint's friction in the state: of one that sticks the direction of sliding (0: it sticks) and the torque
# that holds it; the deflection of bristles.
SLIDING, HELD_BY, DEFLECTION, FRICTION = 0, 1, 0, 2
# Slots of a joint's friction during a step: angle at its begin; at its end rate, and torque that it has had.
BEGUN, TURNS, HAD, DURING = 0, 1, 2, 3
# Slots of a servo rotor's constants: spin axis in the carrier's axes; then these.
C, SPIN, GAIN, INTEGRAL, TORQUE_LIMIT, SERVO = 3, 4, 5, 6, 7, 8
# Slots of a winding's constants: torque per ampere, back-EMF, ...; gains of its loop, and 2 over its delay.
EMF, RESISTANCE, INDUCTANCE, SUPPLY, LOOP_GAIN, LOOP_INTEGRAL, PACE, WINDING = 1, 2, 3, 4, 5, 6, 7, 8
# Slots of a mode's constants: ω², 2 ζ ω; Γ_f; Γ of Omega and every joint; then, at `At.shape`, φ of every torquer.
SQUARE, DAMPING, BASE_FORCE, INERTIAL = 0, 1, 2, 5
# Slots of an erection's constants: sensing axis; then these.
ERECTION_GAIN, ERECTION_LIMIT, ERECTION = 3, 4, 5

# Slots of a body in the workspace: cosine and sine of its joint; rate; velocity product of the acceleration (x, y);
# moment; articulated inertia xx, yy, zz, xy, xz, yz; U/D and u/D of the joint; acceleration; specific force.
COS, SIN, RATE, PRODUCT, MOMENT, INERTIA, GAIN_X, GAIN_Y, DRIVE, ACCELERATION, FORCE, LOCKED, WORK = (
    0, 1, 2, 5, 7, 10, 16, 17, 18, 19, 22, 25, 26,
)  # fmt: skip


class Links(NamedTuple):
    """How the bodies hang together, the same in every scenario."""

    tree: NDArray[np.int64]  # (n, 13)
    turn: FloatArray  # (n, 3, 3)
    servo_carrier: NDArray[np.int64]  # (m,): body
    # (d, 2): gimbals on the load and motor sides of drives that give way; twice that of each winding, and harmonic
    drive: NDArray[np.int64]
    erection: NDArray[np.int64]  # (e, 2): order of the torqued gimbal, sensing body


class PlacedLinks(Links):
    """`Links` of a plant whose masses and joints lie anywhere: code for it is compiled apart."""


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
    modes: int  # of the structure
    torquers: int  # that may excite them
    shape: int  # slots of a mode's constants before φ of the torquers
    dry: int  # the laws of dry friction that there are, 1 << LAW of each
    cages: int
    weight: int  # whether specific force and unbalance or erections act
    field: int  # whether gravity, which is fixed in space, is there
    placed: int  # whether masses and joints lie anywhere, or motors have gears
    floating: int  # whether the root is free to move, not only to turn
    course: int  # whether rotors' momenta change with time
    body: int
    joint: int
    servo: int
    erection: int
    drive: int  # stiffness, damping and half the play of drives that give way
    windings: int  # of motors whose currents are states, those of the last torquers
    teeth: int  # harmonics of cogging
    ripples: int  # harmonics of the torques of currents
    winding: int  # a row of WINDING for each; behind them order, torque or share, and phase of each harmonic
    currents: int  # where in the state currents, integrals and delayed voltages are
    wanted: int  # where in a block the torques are that are wanted of currents
    swings: int  # where in the state the modes are: η and its momentum η̇ + Γ·u of each
    mode: int
    gravity: int  # vector in space
    place: int  # a row of PLACE for each body
    keeps: int  # where in the state the joints' frictions are; 0: none keeps anything
    work: int
    swing: int  # η̇ of the modes at the last state that was looked at
    moving: int  # a row of MOVING for each body
    matrix: int  # A*, (3 + n, 3 + n)
    push: int  # columns of P, (3 + n, 3)
    scratch: int  # a vector
    during: int  # time since the step began; then what every joint's friction needs during a step
    stages: int  # three states: at, derivative, total
    state: int
    surroundings: int  # three blocks: at the beginning, middle and end of a step
    block: int  # slots of a block
    spare_state: int
    spare_block: int
    end: int
