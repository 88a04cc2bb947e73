"""H-infinity and H2 synthesis beside slycot's, in one run: least norms, what the loops really do, and times.

    python benchmarks/synthesis.py [--rounds 5] [--seeds 3] [--lmi-states 16] [--structured]

Random plants are scaled first, so that both sides get the same well-conditioned matrices; the platform's own weighted
plants come in SI units, as a user has them. Times are medians of interleaved rounds, ms. "route" is the synthesis
alone, "call" all that a user waits for: scaling, tests of the assumptions, synthesis, the closed loop's poles and norm.
slycot's routines are called directly and check nothing; what their loops really do is measured here ("slycot true").
"""

from __future__ import annotations

import argparse
import importlib
import importlib.metadata
import importlib.util
import platform
import statistics
import sys
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import control
import numpy as np

from platform_ctrl.analysis.norms import h2_norm, hinf_norm
from platform_ctrl.design.cases import rows_of
from platform_ctrl.design.loop_signals import channels
from platform_ctrl.design.methods import read_job
from platform_ctrl.design.methods.hinf import MixedSensitivity, weighted_plant
from platform_ctrl.design.partition import Partition, autoscale, partition
from platform_ctrl.design.plants import plants_of
from platform_ctrl.design.riccati import hinf_riccati
from platform_ctrl.design.synthesis import Synthesis, h2, hinf
from platform_ctrl.errors import PlatformCtrlError
from platform_ctrl.job.methods import DesignSpec
from platform_ctrl.mechanics.linearisation import linearise

JOB = Path(__file__).parent.parent / "examples" / "three_gyro_platform.toml"
STATES = (6, 10, 15, 20)
DEFAULT_STATES = (4, 8, 16, 29)
PORTS = 4  # of w and of z
MEASURED = CONTROLS = 2
START = 1e3  # gamma from which sb10ad descends

Case = tuple[str, control.StateSpace, int, int]


def slycot_or_none() -> Any:
    """Return slycot where it is installed."""
    try:
        return importlib.import_module("slycot")
    except ImportError:
        return None


def random_plant(states: int, seed: int, direct: bool) -> control.StateSpace:
    """Return a scaled plant with one unstable pole or pair."""
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() - 0.3) * np.eye(states)
    D = 0.5 * rng.normal(size=(PORTS + MEASURED, PORTS + CONTROLS))
    D[PORTS:, PORTS:] = 0
    if not direct:
        D[:PORTS, :PORTS] = 0
    B, C = rng.normal(size=(states, PORTS + CONTROLS)), rng.normal(size=(PORTS + MEASURED, states))
    p = autoscale(partition(control.ss(A, B, C, D), MEASURED, CONTROLS)).plant
    return control.ss(p.A, np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2]), np.block([[p.D11, p.D12], [p.D21, p.D22]]))


def platform_plants() -> list[Case]:
    """Return the weighted plants of the shipped job's caging loops, in the w-plane, in SI units."""
    job = read_job(JOB)
    model = linearise(job.platform)
    out = []
    for spec in job.loops:
        if spec.kind != "caging":
            continue
        plants = plants_of(job, spec)
        assert plants is not None, "a caging loop has plants"
        channel = channels(model, rows_of(model, spec.gimbals))
        given = next((d for d in spec.designs if d.method == "hinf"), DesignSpec(name="hinf", method="hinf"))
        options = MixedSensitivity().defaults(given, channel, plants.nutation, plants.period)
        weighted = weighted_plant(options, channel, plants)
        k = len(weighted.torque_unit)
        P = weighted.arrays.to_control([f"w{i}" for i in range(3 * k)], [f"z{i}" for i in range(4 * k)])
        out.append((spec.name, P, k, k))
    return out


def medians(tasks: dict[str, Callable[[], Any]], rounds: int) -> tuple[dict[str, float], dict[str, Any]]:
    """Return median times, ms, of tasks that take turns, and what they returned or raised."""
    times: dict[str, list[float]] = {name: [] for name in tasks}
    found: dict[str, Any] = {}
    for _ in range(rounds):
        for name, task in tasks.items():
            began = time.perf_counter()
            try:
                found[name] = task()
            except Exception as error:  # whatever slycot raises is a result here
                found[name] = error
            times[name].append(1e3 * (time.perf_counter() - began))
    return {name: statistics.median(ts) for name, ts in times.items()}, found


def sizes(P: control.StateSpace, nmeas: int, ncon: int) -> tuple[int, int, int, int, int]:
    """Return n, m, p, ncon, nmeas as slycot's routines take them."""
    return P.nstates, P.ninputs, P.noutputs, ncon, nmeas


def true_norm(system: control.StateSpace, norm: Callable[[Any], Any]) -> float:
    """Return the norm of a loop, inf where it is not stable or not finite."""
    try:
        value = norm(system)
    except PlatformCtrlError:
        return float("inf")
    return float(value[0] if isinstance(value, tuple) else value)


def _route(plant: Partition, P: control.StateSpace) -> Any:
    return hinf_riccati(plant, 0.02, P)


def hinf_rows(cases: list[Case], slycot: Any, rounds: int) -> None:
    """Print the table of the H-infinity Riccati route."""
    print(f"{'H-infinity, Riccati':<24}{'n':>3}{'gamma':>13}{'slycot':>13}{'rel. dev.':>10}{'slycot true':>13}", end="")
    print(f"{'route':>8}{'call':>8}{'sb10ad':>8}{'/route':>7}{'/call':>7}")
    for name, P, nmeas, ncon in cases:
        plant = partition(P, nmeas, ncon)
        tasks: dict[str, Callable[[], Any]] = {
            "route": partial(_route, plant, P),
            "call": partial(hinf, P, nmeas, ncon, method="riccati"),
        }
        if slycot is not None:
            shape = sizes(P, nmeas, ncon)
            tasks["sb10ad"] = partial(slycot.sb10ad, *shape, START, P.A, P.B, P.C, P.D)
        taken, found = medians(tasks, rounds)
        least = _least(found["call"])
        print(f"{name:<24}{P.nstates:>3}{least:>13.8g}", end="")
        theirs = found.get("sb10ad")
        if theirs is None:
            print(f"{'absent':>13}{'':>23}{taken['route']:>8.1f}{taken['call']:>8.1f}")
        elif isinstance(theirs, Exception):
            print(f"{'no answer':>13}{'':>23}{taken['route']:>8.1f}{taken['call']:>8.1f}{taken['sb10ad']:>8.1f}")
        else:
            true = true_norm(control.ss(*theirs[5:9]), hinf_norm)
            ratios = [taken["sb10ad"] / taken[of] for of in ("route", "call")]
            print(f"{theirs[0]:>13.8g}{least / theirs[0] - 1:>10.1e}{true:>13.8g}", end="")
            print(
                f"{taken['route']:>8.1f}{taken['call']:>8.1f}{taken['sb10ad']:>8.1f}{ratios[0]:>7.1f}{ratios[1]:>7.1f}"
            )


def h2_rows(cases: list[Case], slycot: Any, rounds: int) -> None:
    """Print the table of the H2 Riccati route."""
    print(f"\n{'H2, Riccati':<24}{'n':>3}{'norm':>13}{'slycot true':>13}{'rel. dev.':>10}{'call':>8}{'sb10hd':>8}")
    for name, P, nmeas, ncon in cases:
        tasks: dict[str, Callable[[], Any]] = {"call": partial(h2, P, nmeas, ncon)}
        if slycot is not None:
            shape = sizes(P, nmeas, ncon)
            tasks["sb10hd"] = partial(slycot.sb10hd, *shape, P.A, P.B, P.C, P.D)
        taken, found = medians(tasks, rounds)
        print(f"{name:<24}{P.nstates:>3}{found['call'].gamma:>13.8g}", end="")
        theirs = found.get("sb10hd")
        if theirs is None or isinstance(theirs, Exception):
            print(f"{'absent' if theirs is None else 'no answer':>13}{'':>10}{taken['call']:>8.1f}")
            continue
        true = true_norm(P.lft(control.ss(*theirs[:4]), ncon, nmeas), h2_norm)
        print(f"{true:>13.8g}{found['call'].gamma / true - 1:>10.1e}{taken['call']:>8.1f}{taken['sb10hd']:>8.1f}")


def _least(found: Synthesis) -> float:
    return found.level / (1.0 + found.backoff)


def default_rows(cases: list[Case], slycot: Any, rounds: int, lmi_states: int) -> None:
    """Print the default of `hinf` beside matrix inequalities and `control.hinfsyn`, times in ms and as ratios."""
    print(f"\n{'H-infinity, default':<24}{'n':>3}{'gamma':>13}{'LMI, rel.':>11}", end="")
    print(f"{'hinfsyn, rel.':>14}{'ms':>9}{'LMI, ms':>10}{'hinfsyn':>9}{'LMI/':>8}{'hinfsyn/':>9}")
    for name, P, nmeas, ncon in cases:
        tasks: dict[str, Callable[[], Any]] = {"default": partial(hinf, P, nmeas, ncon)}
        if slycot is not None:
            tasks["hinfsyn"] = partial(control.hinfsyn, P, nmeas, ncon)
        taken, found = medians(tasks, rounds)
        if P.nstates <= lmi_states:
            once = medians({"LMI": partial(hinf, P, nmeas, ncon, method="lmi", time_limit=600.0)}, 1)
            taken, found = taken | once[0], found | once[1]
        least = _least(found["default"])
        print(f"{name:<24}{P.nstates:>3}{least:>13.8g}", end="")
        for route, width in (("LMI", 11), ("hinfsyn", 14)):
            theirs = found.get(route)
            if theirs is None or isinstance(theirs, Exception):
                print(f"{'-' if theirs is None else type(theirs).__name__[: width - 1]:>{width}}", end="")
            elif route == "LMI":
                print(f"{_least(theirs) / least - 1.0:>{width}.1e}", end="")
            else:  # the norm that the loop really has
                print(f"{true_norm(theirs[1], hinf_norm) / least - 1.0:>{width}.1e}", end="")
        ours, lmi, theirs = (taken.get(route, float("nan")) for route in ("default", "LMI", "hinfsyn"))
        print(f"{ours:>9.1f}{lmi:>10.0f}{theirs:>9.1f}{lmi / ours:>8.0f}{theirs / ours:>9.1f}")


def version(name: str) -> str:
    """Return the version of a package, or that it is absent."""
    try:
        return f"{name} {importlib.metadata.version(name)}"
    except importlib.metadata.PackageNotFoundError:
        return f"{name} absent"


def structured(arguments: list[str]) -> None:
    """Run the script beside this one that holds the tables of fixed structures."""
    script = Path(__file__).with_name("structured.py")
    if not script.is_file():
        print("\nFixed structure: no benchmarks/structured.py beside this script")
        return
    specification = importlib.util.spec_from_file_location("structured_benchmark", script)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[specification.name] = module
    specification.loader.exec_module(module)
    print("\nFixed structure")
    sys.argv = [str(script), *arguments]
    module.main()


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds a case")
    parser.add_argument("--seeds", type=int, default=3, help="random plants of every size")
    parser.add_argument("--lmi-states", type=int, default=16, help="matrix inequalities up to so many states")
    parser.add_argument("--structured", action="store_true", help="also the tables of benchmarks/structured.py")
    chosen, rest = parser.parse_known_args()
    if rest and not chosen.structured:
        parser.error(f"unknown option {rest[0]}; --structured passes further options on")
    warnings.simplefilter("ignore")
    slycot = slycot_or_none()
    packages = ("numpy", "scipy", "control", "slycot", "cvxpy", "clarabel")
    print(f"{time.strftime('%Y-%m-%d')}, Python {platform.python_version()}, {', '.join(map(version, packages))}\n")
    full: list[Case] = []
    strict: list[Case] = []
    for n in STATES:
        for seed in range(chosen.seeds):
            full.append((f"random {seed}, scaled", random_plant(n, seed, True), MEASURED, CONTROLS))
            strict.append((f"random {seed}, scaled", random_plant(n, seed, False), MEASURED, CONTROLS))
    own = platform_plants()
    hinf_rows(full + [(f"{name}, SI", *rest) for name, *rest in own], slycot, chosen.rounds)
    h2_rows(strict, slycot, chosen.rounds)
    sizes_too = [(f"random 0, scaled, {n}", random_plant(n, 0, True), MEASURED, CONTROLS) for n in DEFAULT_STATES]
    default_rows(sizes_too + [(f"{name}, SI", *rest) for name, *rest in own], slycot, chosen.rounds, chosen.lmi_states)
    if chosen.structured:
        structured(rest)


if __name__ == "__main__":
    main()
