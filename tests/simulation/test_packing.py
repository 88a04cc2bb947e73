"""Plants are packed many at a time: to the bit as each alone, and what they share is found once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from platform_ctrl import read_platform
from platform_ctrl.errors import ArgumentError
from platform_ctrl.job.scenario import Scenario
from platform_ctrl.plant.force_elements import Cage, Erection, Friction, Spring, Unbalance
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.source import shipped_models
from platform_ctrl.simulation import simulate_batch
from platform_ctrl.simulation.packing import numbers, pack, skeleton

MODELS = sorted(shipped_models())


def furnished(name: str) -> Platform:
    """Return a model with every kind of rotor and element."""
    platform = read_platform(name)
    first, last = platform.gimbals[0].name, platform.gimbals[-1].name
    kinds = ("servo", "free", "regulated")
    return replace(
        platform,
        rotors=tuple(replace(r, control=kinds[k % 3], speed_gain=1e-4) for k, r in enumerate(platform.rotors)),
        springs=(*platform.springs, Spring(gimbal=last, stiffness=0.01, rest=0.02)),
        cages=(Cage(gimbal=first, stiffness=0.3, damping=1e-4, clearance=0.01),),
        unbalances=(*platform.unbalances, *[Unbalance(body=last, moment=np.array([1e-4, 2e-4, k])) for k in range(2)]),
        erections=(Erection(gimbal=first, senses=last, axis=np.array([0.6, 0.8, 0.0]), gain=1e-3),),
        specific_force=np.array([0.1, 0.2, 9.8]),
    )


def scattered(platform: Platform, rng: np.random.Generator) -> Platform:
    """Return a plant of the same parts with other numbers."""

    def x() -> float:
        return rng.uniform(0.9, 1.1)

    return replace(
        platform,
        root_inertia=x() * platform.root_inertia,
        gimbals=tuple(replace(g, inertia=x() * g.inertia) for g in platform.gimbals),
        rotors=tuple(
            replace(
                r,
                axial_inertia=x() * r.axial_inertia,
                transverse_inertia=x() * r.transverse_inertia,
                angular_momentum=x() * r.angular_momentum,
            )
            for r in platform.rotors
        ),
        springs=tuple(replace(s, stiffness=x() * s.stiffness) for s in platform.springs),
        frictions=tuple(replace(f, viscous=x() * f.viscous) for f in platform.frictions),
        cages=tuple(replace(c, damping=x() * c.damping) for c in platform.cages),
        unbalances=tuple(replace(u, moment=x() * u.moment) for u in platform.unbalances),
        erections=tuple(replace(e, gain=x() * e.gain) for e in platform.erections),
        specific_force=x() * platform.specific_force,
    )


@pytest.mark.parametrize("make", [read_platform, furnished])
@pytest.mark.parametrize("name", MODELS)
def test_a_plant_is_packed_among_others_as_alone_to_the_bit(name, make):
    rng = np.random.default_rng(5)
    plants = [scattered(make(name), rng) for _ in range(33)]
    shape = skeleton(plants[0])
    assert all(skeleton(one) is shape for one in plants)
    constants, around = numbers(shape, plants)
    assert len(np.unique(constants, axis=0)) == len(plants)
    for k, one in enumerate(plants):
        alone = pack(one)
        np.testing.assert_array_equal(constants[k], alone.constants)
        np.testing.assert_array_equal(around[k], alone.around)


@pytest.mark.parametrize(
    "other",
    [
        lambda p: replace(p, rotors=p.rotors[::-1]),
        lambda p: replace(p, rotors=(replace(p.rotors[0], control="free"), *p.rotors[1:])),
        lambda p: replace(p, gimbals=(replace(p.gimbals[0], axis=-p.gimbals[0].axis), *p.gimbals[1:])),
        lambda p: replace(p, gimbals=(replace(p.gimbals[0], stops=None), *p.gimbals[1:])),
        lambda p: replace(p, torquers=p.torquers[::-1]),
        lambda p: replace(p, pickoffs=p.pickoffs[1:]),
        lambda p: replace(p, frictions=(Friction(gimbal=p.gimbals[0].name, coulomb=(1e-3, 1e-3)),)),
    ],
)
def test_plants_of_other_parts_share_no_skeleton(other):
    platform = read_platform("three_gyro_platform")
    assert skeleton(other(platform)) is not skeleton(platform)
    assert skeleton(replace(platform, name="another")) is skeleton(platform)


def test_of_many_plants_the_one_whose_step_is_too_long_is_found():
    platform = furnished("three_gyro_platform")
    stiff = replace(platform, cages=(replace(platform.cages[0], stiffness=3e4),))
    run = Scenario(platform=platform, mode="caged", duration=0.001, delay=0.0)
    runs = [replace(run, run=k) for k in range(9)]
    assert simulate_batch(runs, [], period=1e-3, step=1e-4).completed.all()
    with pytest.raises(ArgumentError, match=r"step: 0.0001 s is too long for the cage of gimbal '4'; take at most"):
        simulate_batch([*runs, replace(run, platform=stiff), *runs], [], period=1e-3, step=1e-4)
