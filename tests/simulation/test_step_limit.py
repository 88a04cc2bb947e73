"""Steps that are too long for stiff elements are refused with the step that would do; and that step does."""

import numpy as np
import pytest

from platform_ctrl import read_platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.simulation import rollout
from single_runs import simulated

J = 1e-3


def gimbal(**elements):
    return read_platform(
        {
            "schema": 1,
            "name": "one gimbal",
            "root": {"name": "base", "inertia": [1e3, 1e3, 1e3]},
            "gimbal": [{"name": "a", "parent": "base", "axis": [0, 0, 1], "inertia": [J, J, J]}],
            **elements,
        }
    )


def energy(platform, q, rate):
    """Kinetic, and of the cage beyond its play."""
    beyond = max(abs(q) - platform.cages[0].clearance, 0.0)
    return 0.5 * J * rate**2 + 0.5 * platform.cages[0].stiffness * beyond**2


def caged(platform, step, duration=0.5):
    return simulated(platform, [], period=1e-3, delay=0.0, duration=duration, mode="caged", rate=[0.5], step=step)


def test_a_cage_keeps_the_energy_at_the_step_that_is_allowed_and_is_refused_beyond():
    platform = gimbal(cage=[{"gimbal": "a", "stiffness": 1e6, "clearance": 1e-3}])
    allowed = 0.3 * np.sqrt(J / 1e6)
    with pytest.raises(ArgumentError, match=r"step: 0.0001 s is too long for the cage of gimbal 'a'; take at most 9"):
        caged(platform, 1e-4)
    run = caged(platform, 0.99 * allowed)
    assert run.completed
    before, after = energy(platform, 0.0, 0.5), energy(platform, run.q[-1, 0], run.rate[-1, 0])
    assert after == pytest.approx(before, rel=0.05)


@pytest.mark.parametrize(
    ("elements", "kind"),
    [
        ({"spring": [{"gimbal": "a", "stiffness": 1e12}]}, "spring"),
        ({"friction": [{"gimbal": "a", "viscous": 1e5}]}, "friction"),
        ({"friction": [{"gimbal": "a", "coulomb": 1.0, "coulomb_rate": 0.01}]}, "friction"),
        ({"friction": [{"gimbal": "a", "coulomb": 1.0, "bristle_stiffness": 1e12}]}, "bristles"),
        ({"cage": [{"gimbal": "a", "stiffness": 1.0, "damping": 1e6}]}, "cage"),
    ],
)
def test_every_stiff_element_is_named_by_both_kinds_of_run(elements, kind):
    platform = gimbal(**elements)
    for call in (lambda: rollout(platform, [[0.0]], np.ones((1, 4))), lambda: caged(platform, 1e-4)):
        with pytest.raises(ArgumentError, match=f"is too long for the {kind} of gimbal 'a'"):
            call()


def test_dry_friction_stops_a_gimbal_where_the_equation_says():
    """With the step that the message asks for: at rest after v² J/(2 F)."""
    platform = gimbal(friction=[{"gimbal": "a", "coulomb": 0.1, "coulomb_rate": 1e-3}])
    with pytest.raises(ArgumentError, match="a larger coulomb_rate") as refused:
        rollout(platform, [[0.0]], [[0, 0, 0, 0.5]], step=1e-3)
    step = float(str(refused.value).split("at most ")[1].split(" s")[0])
    out = rollout(platform, [[0.0]], [[0, 0, 0, 0.5]], step=step, steps=round(0.02 / step))
    assert out.q[0, 0] == pytest.approx(0.5**2 * J / (2 * 0.1), rel=0.02)
    assert abs(out.velocity[0, 3]) < 1e-6
