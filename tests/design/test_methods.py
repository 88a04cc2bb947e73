"""Every registered design method keeps the contract that the job reader, `design.loops` and the app rely on."""

from __future__ import annotations

import copy
import dataclasses
import functools
import math
import pickle
import tomllib
from typing import ClassVar

import pytest

from camera_job import camera_job
from one_gyro_job import JOB as ONE
from platform_ctrl.design.loop import Design
from platform_ctrl.design.method import LoopProblem, Method, Option, designed
from platform_ctrl.design.methods import METHODS, read_job
from platform_ctrl.design.plants import plants_of
from platform_ctrl.errors import ArgumentError, DesignError, InputError
from platform_ctrl.job.methods import DesignSpec, register_method
from platform_ctrl.mechanics.linearisation import linearise

EVERY = pytest.mark.parametrize("key", METHODS)
CAGING = pytest.mark.parametrize("key", [key for key, method in METHODS.items() if "stabilisation" not in method.kinds])


@functools.cache
def problem_of(key: str, **options: float) -> LoopProblem:
    job = read_job(tomllib.loads(ONE))
    if METHODS[key].kinds == ("stabilisation",):
        job = read_job("examples/three_gyro_platform.toml")
    elif "caging" not in METHODS[key].kinds:
        job = read_job(camera_job())
    spec = next(one for one in job.loops if one.kind in METHODS[key].kinds)
    design = DesignSpec(name="tried", method=key, options=options)
    return LoopProblem(job=job, spec=spec, design=design, model=linearise(job.platform), plant_set=plants_of(job, spec))


@EVERY
def test_the_entry_of_a_method_is_complete(key: str) -> None:
    method = METHODS[key]
    assert method.key == key
    assert method.advice
    assert set(method.tunable) <= set(method.options)
    assert {option.part for option in method.options.values()} - {""} == set(method.parts)
    for option in method.options.values():
        assert option.label
        assert option.tip
        assert option.low < option.high


@EVERY
def test_a_design_has_finite_numbers_for_known_options_and_is_the_same_again(key: str) -> None:
    problem = problem_of(key, **({"steps": 3} if key == "measured" else {}))
    design, again = designed(problem), designed(problem)
    assert design.method == key
    assert set(design.options) <= set(METHODS[key].options) | set(METHODS["classical"].options)
    assert all(math.isfinite(x) for x in (*design.options.values(), *design.claims.values()))
    assert design.controller.dt == pytest.approx(problem.job.sampling.period)
    for other in (again, pickle.loads(pickle.dumps(design)), copy.deepcopy(design)):
        assert other.controller.A.tolist() == design.controller.A.tolist()
        assert other.options == design.options


@CAGING
def test_default_options_are_positive_and_those_that_are_given_stay(key: str) -> None:
    problem = problem_of(key)
    defaults = METHODS[key].defaults
    scale = problem.channel, problem.plants.nutation, problem.plants.period
    found = defaults(problem.design, *scale)
    assert set(found) <= set(METHODS[key].options)
    assert all(x > 0.0 for x in found.values())
    for name, x in found.items():
        given = dataclasses.replace(problem.design, options={name: x})
        assert defaults(given, *scale)[name] == x


@EVERY
def test_an_option_that_a_method_does_not_know_is_named(key: str) -> None:
    with pytest.raises(DesignError, match="option 'colour' has no meaning"):
        designed(problem_of(key, colour=1.0))


def test_a_method_is_known_to_the_reader_as_long_as_it_is_registered() -> None:
    job = ONE.replace('method = "classical", crossover_hz = 40, integral_hz = 2', 'method = "mine", stiffness = 2')

    class Mine(Method):
        key = "mine"
        options: ClassVar = {"stiffness": Option(label="stiffness", unit="N m/rad", tip="torque over angle")}
        advice = "another one"

        def design(self, problem: LoopProblem) -> Design:
            raise NotImplementedError

    data = tomllib.loads(job)
    register_method(Mine)
    try:
        assert read_job(data).loops[0].designs[0].options == {"stiffness": 2.0}
        with pytest.raises(ArgumentError, match="there is a method 'mine' already"):
            register_method(Mine)
    finally:
        del METHODS["mine"]
    with pytest.raises(InputError, match=r'method must be "classical" or .* or "platform-servo", got "mine"'):
        read_job(data)
