"""Whether precession theory (15) may be used for a subsystem, what stands in its way, and what would cure it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from platform_ctrl.linearisation import LinearModel
from platform_ctrl.mechanics.kinematics import topology
from platform_ctrl.precession.choice import chosen
from platform_ctrl.precession.part import PrecessionPart
from platform_ctrl.precession.reduction import scaled
from platform_ctrl.precession.restraint import NOTHING
from platform_ctrl.precession.wording import keep, lack, named_directions

# Loop frequency where none is given, against the highest nutation frequency.
_SLOW = 0.01


def judged(model: LinearModel, rows: Sequence[int], loop_frequency: float | None, required: float) -> PrecessionPart:
    """Return the test of one subsystem, the gimbals in `rows`.

    Raises
    ------
    MechanicsError
        Its mass matrix is singular (gimbal lock).
    """
    at = scaled(model, rows)
    gimbals, angles = [model.gimbal_names[k] for k in rows], [model.angle_names[k] for k in rows]
    _, gyro, right = np.linalg.svd(at.T.T @ model.G[np.ix_(rows, rows)] @ at.T)
    null = right[int(np.sum(gyro > NOTHING * gyro[0])) :].T
    if loop_frequency is None:
        loop_frequency = _SLOW * float(gyro[0])
    turning = _turns(model, rows)
    choice = chosen(at, null, turning, loop_frequency, required)
    directions, names, _ = named_directions(at, null, angles)
    kept, kept_names, _ = named_directions(at, choice.cured.N, angles)
    findings = choice.trial.obstacles(required)
    if not turning:
        findings.insert(0, ("no rotor gives it any momentum", "give it a rotor that spins"))
    elif not choice.held:
        findings.insert(0, lack(at, null, names, required * loop_frequency))
    cures = [keep(kept_names, len(rows)), *dict.fromkeys(f"or {cure}" for _, cure in findings)]
    return PrecessionPart(
        model=model,
        gimbals=tuple(gimbals),
        loop_frequency=loop_frequency,
        required_separation=required,
        singular_values=gyro,
        null_directions=directions,
        direction_names=names,
        momentum_directions=kept,
        reasons=tuple(f"{'-'.join(gimbals)}: {reason}" for reason, _ in findings),
        cures=tuple(cures if findings else ()),
        _choice=choice,
    )


def _turns(model: LinearModel, rows: Sequence[int]) -> bool:
    """Whether any of these gimbals carries a rotor that spins."""
    tree = topology(model.platform)
    return bool(np.any(tree.on_path[tree.carriers][:, rows] & (tree.L[:, None] != 0.0)))
