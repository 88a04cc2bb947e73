"""The shapes that docstrings state are those of real results: letters stand for one number throughout a value."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import control
import numpy as np
import pytest
from numpydoc.docscrape import NumpyDocString, Parameter

import platform_ctrl as pc
from contract_cases import PERIOD, coordinates, crossover, general, model, pair, platform, shaped, varying
from platform_ctrl import analysis, design, simulation
from platform_ctrl.analysis.certificates.makers import stability_certificate
from platform_ctrl.design.antiwindup.loop import LimitedLoop
from platform_ctrl.simulation.batch import BatchResult
from platform_ctrl.simulation.closed_loop import Trajectory
from platform_ctrl.simulation.free_motion import Rollout

PLATFORM = platform()
MODEL = model()
PAIR = pair()


def gyro() -> tuple[control.StateSpace, control.StateSpace]:
    """Return the sampled pair of gimbals 9 and 10 from torques to angles, and a controller for it."""
    made = crossover()
    return made.plant, made.controller


@functools.cache
def limited() -> LimitedLoop:
    return design.limited_loop(PAIR, gyro()[1], "Omega1", limits=0.5, rise=0.5)


def trajectory() -> Trajectory:
    scenario = simulation.Scenario(platform=PLATFORM, mode="stabilised", duration=0.01, delay=0.0)
    return simulation.simulate(scenario, [], period=PERIOD)


def batch() -> BatchResult:
    runs = [
        simulation.Scenario(platform=PLATFORM, mode="caged", duration=0.01, delay=0.0, seed=1, run=k) for k in range(3)
    ]
    return simulation.simulate_batch(runs, [], period=PERIOD)


def rolled() -> Rollout:
    return simulation.rollout(PLATFORM, q=[[0.01] * 5] * 3, velocity=[[0.02] * 8] * 3, step=1e-4, steps=4, every=2)


VALUES: dict[str, Callable[[], Any]] = {
    "Platform": lambda: PLATFORM,
    "Gimbal": lambda: PLATFORM.gimbals[0],
    "Rotor": lambda: PLATFORM.rotors[0],
    "LinearModel": lambda: MODEL,
    "MagnusMatrices": lambda: pc.matrices(PLATFORM, velocity=[0.1] * 8),
    "RotorMomenta": lambda: pc.rotor_momenta(PLATFORM),
    "ParameterVaryingModel": varying,
    "AffineModel": lambda: varying().affine(),
    "FrozenRows": lambda: varying().at([0.1, 0.0, 0.0]),
    "FrozenSystem": lambda: varying().grid(2, [0.1, 0.0, 0.0])[0],
    "PrecessionPart": lambda: pc.precession(MODEL).part("4"),
    "TermTable": lambda: pc.terms(PLATFORM, Omega=(1, 1, 1), rates=[0.01] * 5),
    "Damping": lambda: analysis.damping(PAIR),
    "Gang": lambda: analysis.gang(*gyro(), [1.0, 10.0, 100.0]),
    "DiskMargin": lambda: analysis.disk_margin(analysis.loop_transfer(*gyro())),
    "LoopMargins": lambda: analysis.loop_margins(*gyro()),
    "Synthesis": lambda: design.hinf(general(), 1, 1, method="riccati"),
    "StateFeedback": lambda: design.lqr(general(), np.eye(2), np.eye(3)),
    "Estimator": lambda: design.lqe(general(), np.eye(2), np.eye(3)),
    "PolePlacement": lambda: design.pole_placement(control.ss([[0, 1], [0, 0]], [[0], [1]], np.eye(2), 0), [-1, -2]),
    "ComplexSystem": coordinates,
    "TwoSidedNyquist": lambda: shaped().nyquist,
    "LimitedLoop": limited,
    "Certificate": lambda: stability_certificate([[-1.0, 0.0], [0.0, -2.0]]),
    "Rollout": rolled,
    "Trajectory": trajectory,
    "BatchResult": batch,
}


# Public functions that return one array, with arguments of which no two sizes are alike by chance.
CALLS: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    name: (function, arguments)
    for name, function, arguments in (
        ("element_forces", pc.element_forces, {"platform": PLATFORM, "q": [0.0] * 5}),
        ("forward_dynamics", pc.forward_dynamics, {"q": [0.0] * 5, "velocity": [0.1] * 8, "force": [0.0] * 8}),
        ("inverse_dynamics", pc.inverse_dynamics, {"q": [0.0] * 5, "velocity": [0.1] * 8, "acceleration": [0.0] * 8}),
        ("frequency_response", analysis.frequency_response, {"system": PAIR, "frequency": np.ones(7)}),
        (
            "time_response",
            analysis.time_response,
            {"system": PAIR, "timepts": np.arange(7) * 0.1, "inputs": np.ones((5, 7)), "initial_state": np.ones(4)},
        ),
        ("noise_rms", analysis.noise_rms, {"system": control.ss(0.5, [[1, 1]], [[1], [2], [3]], 0, 1), "rms": [1, 2]}),
        ("error", pc.precession(MODEL, gimbals=("9", "10")).error, {"frequency": [1.0, 2.0, 3.0]}),
        ("state", varying().state, {"q": [0.0, 0.1], "rates": [0.0, 0.0], "Omega": [0.0, 0.0, 1.0]}),
        ("rhs", varying().rhs, {"t": 0.0, "x": np.zeros(4), "Omega": np.zeros(3), "Q": np.zeros(2)}),
    )
}


def shapes(section: Sequence[Parameter]) -> Iterator[tuple[str, str]]:
    """Yield names whose shape a section states, with that shape: one for all names, or one for each."""
    for entry in section:
        names = [name.strip() for name in entry.name.split(",")]
        _, told, rest = " ".join(entry.desc).partition("hapes (")
        several = re.findall(r"\([^()]*\)", f"({rest}") if told else []
        one = re.findall(r"\([^()]*,[^()]*\)", entry.type)[:1]
        yield from zip(names, one * len(names) or several, strict=False)


def sides(shape: str) -> list[str]:
    """Return what stands between the commas of a shape, as Python reads it: words in one piece, products with *."""
    parts = [re.sub(r"([a-z]) ([a-z])", r"\1_\2", side.strip()) for side in shape.strip("()").split(",")]
    return [re.sub(r"(\d)([a-z])", r"\1 * \2", side) for side in parts if side]


def held(shape: str, actual: tuple[int, ...], letters: dict[str, int]) -> bool:
    """Whether a shape is the stated one; a letter that is new gets its number here, alone or in a sum."""
    stated = sides(shape)
    if "..." in stated:
        return True
    if len(stated) != len(actual):
        return False
    for side, number in zip(stated, actual, strict=True):
        new = sorted(set(re.findall(r"[A-Za-z_]+", side)) - set(letters))
        if len(new) > 1:  # a sum of which two parts are not known yet
            continue
        fitting = [k for k in range(number + 1) if eval(side, {}, letters | dict.fromkeys(new, k)) == number]
        if not fitting:
            return False
        letters |= dict.fromkeys(new, fitting[0])
    return True


@pytest.mark.parametrize("name", VALUES)
def test_arrays_have_the_shapes_that_their_docstring_states(name: str) -> None:
    found = VALUES[name]()
    assert type(found).__name__ == name
    letters: dict[str, int] = {}
    section = NumpyDocString(inspect.cleandoc(type(found).__doc__ or ""))["Attributes"]
    stated = [(attribute, shape) for attribute, shape in shapes(section) if getattr(found, attribute) is not None]
    assert stated
    # Single letters first: sums of them are known afterwards.
    for attribute, shape in sorted(stated, key=lambda pair: "+" in pair[1]):
        array = np.asarray(getattr(found, attribute))
        if array.size:  # an empty one stands for what there is not
            assert held(shape, array.shape, letters), f"{attribute}: {array.shape} is not {shape} with {letters}"


@pytest.mark.parametrize("name", CALLS)
def test_functions_return_arrays_of_the_shape_that_their_docstring_states(name: str) -> None:
    function, arguments = CALLS[name]
    if "platform" in inspect.signature(function).parameters:
        arguments = arguments | {"platform": PLATFORM}
    doc = NumpyDocString(inspect.cleandoc(function.__doc__ or ""))
    letters: dict[str, int] = {}
    batch: tuple[int, ...] = ()
    for parameter, shape in shapes(doc["Parameters"]):
        if parameter in arguments:
            own, size = shape.replace("..., ", ""), np.shape(arguments[parameter])
            if own != shape:
                batch, size = size[: -len(sides(own))], size[-len(sides(own)) :]
            assert held(own, size, letters), f"{parameter}: {size} is not {own}"
    [returned] = doc["Returns"]
    stated = re.findall(r"\((?:\.\.\.|[^()]*,[^()]*)\)", returned.type)[0]
    actual = np.shape(function(**arguments))
    if "..." in stated:
        assert actual[: len(batch)] == batch
        stated, actual = re.sub(r"\.\.\.(, )?", "", stated), actual[len(batch) :]
    assert held(stated, actual, letters), f"{actual} is not {stated} with {letters}"
