"""The platform servo: rates from the torques of the caged gyros, angles by integration, torques on the root.

A caged gyro measures: in the steady state Q = G_Omega Omega at zero angles, for the three-gyro platform Q9 = L11
Omega1, Q5 + Q7 = −(L6 + L8) Omega2, Q10 = −L11 Omega3. The least-squares inverse of G_Omega gives the rates; a
second-order low-pass keeps the pick-offs' noise out of the root's torquers; then

    M = −J ωc (Omega + ωp ∫Omega dt),        J the inertia of the root with the gimbals at rest in it.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.design.loop import Design
from platform_ctrl.design.loop_signals import parallel
from platform_ctrl.design.method import LoopProblem, Method, Option, hertz, number
from platform_ctrl.design.sections import Section, first_order, flattened, gain, low_pass
from platform_ctrl.errors import DesignError
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.mechanics.linearisation import LinearModel

# A gyro torque whose share in a rate is smaller than this (relative to the largest) is not measured for it.
_NO_SHARE = 1e-9


OPTIONS: dict[str, Option] = {
    "crossover_hz": hertz(
        "crossover ωc", "gains", "gain over inertia: where the rate loop of the platform crosses over", high=0.1
    ),
    "position_hz": hertz("position", "gains", "angle over rate feedback: below this frequency the angle is held"),
    "filter_hz": hertz(
        "rate filter", "lead", "low-pass on the rates that the gyros show", high=0.45, below_nyquist=True
    ),
    "filter_damping": number("filter damping", "its damping ratio", 0.1, 2.0, "lead"),
}


class PlatformServo(Method):
    """The servo of the three root axes."""

    key = "platform-servo"
    kinds = ("stabilisation",)
    options = OPTIONS
    advice = "a lower crossover_hz"
    tunable = tuple(OPTIONS)
    instant = True

    def design(self, problem: LoopProblem) -> Design:
        """Return the servo of the three root axes for the options of the design.

        ``crossover_hz`` ωc of the rate loop, ``position_hz`` ωp, ``filter_hz`` and ``filter_damping`` of the low-pass.
        """
        options = self.all_options(problem.design, problem.job.sampling.period)
        sections = self.sections(problem, options)
        inputs, outputs = sections[0].inputs, sections[-1].outputs
        return problem.made(flattened(sections, inputs, outputs), options, inputs=inputs, outputs=outputs)

    def all_options(self, design: DesignSpec, period: float) -> dict[str, float]:
        """Return all options of a design, those that are not given as shares of the crossover."""
        crossover = design.options.get("crossover_hz", 5.0)
        defaults = {"crossover_hz": crossover, "position_hz": 0.3 * crossover}
        defaults |= {"filter_hz": 10.0 * crossover, "filter_damping": 0.7}
        return self.completed(design.options, defaults, period)

    def sections(self, problem: LoopProblem, options: dict[str, float]) -> tuple[Section, ...]:
        """Return the servo section by section, from the gyros' torques to those on the root."""
        model, job = problem.model, problem.job
        estimate, used = rate_estimate(model)
        torquers = {t.gimbal or t.root_axis: t.name for t in job.platform.torquers}
        missing = [name for name in (model.gimbal_names[k] for k in used) if name not in torquers]
        if missing or not {1, 2, 3} <= set(torquers):
            wanted = f"gimbal {missing[0]}" if missing else "root axes 1, 2 and 3"
            raise DesignError(f"{problem.spec.name}: there is no torquer on {wanted}; add one to the plant file", model)
        measured = tuple(torquers[model.gimbal_names[k]] for k in used)
        set_ = tuple(torquers[axis] for axis in (1, 2, 3))
        turns, speeds = _per_axis("turn"), _per_axis("speed")
        note = f"inertia of the platform times {options['crossover_hz']:.6g} Hz"
        strength = -2.0 * np.pi * options["crossover_hz"] * model.root_inertia
        return (
            Section("rates", "mix", "platform rates by least squares from L Omega", gain(estimate), measured, turns),
            *_axis_sections(options, job.sampling.period),
            Section("servo", "mix", note, gain(strength), speeds, set_),
        )


def rate_estimate(model: LinearModel) -> tuple[FloatArray, list[int]]:
    """Return E with Omega = E Q in the steady state of the caged gyros, (3, used), and the gimbal rows used."""
    left, sizes, right = np.linalg.svd(model.G_Omega, full_matrices=False)
    if sizes.size < 3 or sizes[-1] < 1e-6 * sizes[0]:
        # The last of all three directions, also where fewer gimbals are caged.
        blind = np.linalg.svd(model.G_Omega)[2][-1]
        why = parallel("gyros of gimbals", model.gimbal_names, list(model.G_Omega), "show the rate about")
        raise DesignError(
            "platform-servo: the torques of the caged gyros do not depend on the rate about "
            f"({', '.join(f'{x:.2f}' for x in blind)}){why}; add a rotor whose torque G_Omega Omega does",
            model,
        )
    inverse = (right.T / sizes) @ left.T
    used = [k for k in range(inverse.shape[1]) if np.abs(inverse[:, k]).max() > _NO_SHARE * np.abs(inverse).max()]
    return inverse[:, used], used


def _axis_sections(options: dict[str, float], period: float) -> list[Section]:
    """Return low-pass, integral and their sum for every axis."""
    rad = {name: 2.0 * np.pi * x for name, x in options.items() if name.endswith("_hz")}
    low = low_pass(rad["filter_hz"], options["filter_damping"], period)
    integral = first_order(0.0, 1.0, 1.0, 0.0, period)
    mix = gain(np.array([[1.0, rad["position_hz"]]]))
    corner, damping = options["filter_hz"], options["filter_damping"]
    filtered = f"low-pass at {corner:.6g} Hz, damping {damping:.6g}, by Tustin's rule prewarped there"
    summed = f"Omega + wp angle: corner at {options['position_hz']:.6g} Hz"
    out = []
    for k, (turn, speed) in enumerate(zip(_per_axis("turn"), _per_axis("speed"), strict=True), 1):
        rate, angle = f"rate_{k}", f"angle_{k}"
        out.append(Section(f"low_pass_{k}", "low-pass", filtered, low, (turn,), (rate,)))
        out.append(
            Section(f"integral_{k}", "integral", "1/s, angle from rate, by Tustin's rule", integral, (rate,), (angle,))
        )
        out.append(Section(f"sum_{k}", "mix", summed, mix, (rate, angle), (speed,)))
    return out


def _per_axis(name: str) -> tuple[str, str, str]:
    return f"{name}_1", f"{name}_2", f"{name}_3"
