"""The simulation kernel beside MuJoCo's rollout: speed, threads, what a million steps keep, and compilation."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from side_by_side import Comparison, DisagreementError, Section

from platform_ctrl.common.values import FloatArray
from platform_ctrl.mechanics.matrices import matrices
from platform_ctrl.plant.platform import Platform
from platform_ctrl.plant.reading import read_platform
from platform_ctrl.simulation import rollout

MODEL = Path(__file__).parent.parent / "models" / "three_gyro_platform.toml"
RUNS, STEPS, STEP = 128, 1000, 1e-5
# A million steps of each length are judged by what they keep.
LENGTHS = (1e-4, 2e-5, 5e-6)

# Where a run stands: q (..., n), [Omega, rates] (..., 3 + n), attitude (..., 4).
Motion = tuple[FloatArray, FloatArray, FloatArray]


@cache
def plant() -> Platform:
    """Return the three-gyro platform with free rotors: MuJoCo knows none under ideal speed control."""
    platform = read_platform(MODEL)
    return dataclasses.replace(platform, rotors=tuple(dataclasses.replace(r, control="free") for r in platform.rotors))


def starts(runs: int) -> tuple[FloatArray, FloatArray]:
    """Return angles and rates at the start: gimbals out of place, and the gyros nutating."""
    rng = np.random.default_rng(0)
    rates = rng.normal(size=(runs, 8)) * [0.1, 0.1, 0.1, 0.5, 0.5, 0.5, 0.5, 0.5]
    return 0.1 * rng.normal(size=(runs, 5)), rates


class InMujoco:
    """The same platform in MuJoCo: a ball joint, hinges, and a body for every rotor."""

    def __init__(self, platform: Platform) -> None:
        import mujoco

        spec = mujoco.MjSpec()
        spec.option.gravity = (0.0, 0.0, 0.0)
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
        # Nothing touches anything here: without this MuJoCo looks for contacts and is slower.
        spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        spec.compiler.degree = False
        spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
        made: dict[str, Any] = {"": spec.worldbody}
        places: dict[str, int] = {}

        def add(parent: str, name: str, inertia: FloatArray, axis: FloatArray | None) -> None:
            full = (*np.diag(inertia), inertia[0, 1], inertia[0, 2], inertia[1, 2])
            body = made[parent].add_body(name=name, mass=1.0, ipos=np.zeros(3), fullinertia=full, explicitinertial=True)
            kind = mujoco.mjtJoint.mjJNT_BALL if axis is None else mujoco.mjtJoint.mjJNT_HINGE
            body.add_joint(name=name, type=kind, **({} if axis is None else {"axis": axis}))
            made[name] = body

        add("", platform.root_name, platform.root_inertia, None)
        for gimbal in platform.gimbals:
            add(gimbal.parent, gimbal.name, gimbal.inertia, gimbal.axis)
        for r in platform.rotors:
            along = np.outer(r.axis, r.axis)
            inertia = r.transverse_inertia * (np.eye(3) - along) + r.axial_inertia * along
            add(r.carrier, f"rotor {r.name}", inertia, r.axis)
        self.platform, self.model = platform, spec.compile()
        self.data, self.kind = mujoco.MjData(self.model), mujoco.mjtState.mjSTATE_FULLPHYSICS
        for name in made:
            if name:
                places[name] = self.model.joint(name).dofadr[0]
        self.gimbals = np.array([places[g.name] for g in platform.gimbals])
        self.rotors = np.array([places[f"rotor {r.name}"] for r in platform.rotors])

    def states(self, step: float, q: FloatArray, rates: FloatArray) -> FloatArray:
        """Return MuJoCo's states (runs, ...) of the same motion, and set the step."""
        import mujoco

        self.model.opt.timestep = step
        out = np.empty((len(q), mujoco.mj_stateSize(self.model, self.kind)))
        nominal = np.array([r.spin for r in self.platform.rotors])
        for row, angles, u in zip(out, q, rates, strict=True):
            self.data.qpos[:4] = (1.0, 0.0, 0.0, 0.0)
            self.data.qpos[1 + self.gimbals] = angles
            self.data.qvel[:3], self.data.qvel[self.gimbals] = u[:3], u[3:]
            # The rotors' momenta are absolute: their spin is what the carrier's rate leaves of them.
            self.data.qvel[self.rotors] = nominal - matrices(self.platform, angles).B @ u
            mujoco.mj_getState(self.model, self.data, row, self.kind)
        return out

    def run(self, states: FloatArray, steps: int) -> FloatArray:
        """Return all states after every step, (runs, steps, ...)."""
        from mujoco import rollout as theirs

        return np.asarray(theirs.rollout(self.model, self.data, states, nstep=steps)[0])

    def motion(self, states: FloatArray) -> Motion:
        """Return the platform's part of states."""
        nq = self.model.nq
        places = np.concatenate([[0, 1, 2], self.gimbals])
        return states[..., 2 + self.gimbals], states[..., 1 + nq + places], states[..., 1:5]


def _same_motion(ours: Any, theirs: Mapping[str, Any]) -> str:
    """Compare where all runs end, against how far they have come."""
    words = []
    q, _ = starts(RUNS)
    for (mujoco, states), mine in ((answer, ours) for answer in theirs.values()):
        angles, rates, attitude = mujoco.motion(states[:, -1])
        away = max(
            np.abs(mine.q - angles).max() / np.abs(mine.q - q).max(),
            np.abs(mine.velocity - rates).max() / np.abs(rates).max(),
            np.abs(mine.attitude - attitude).max(),
        )
        if not away < 1e-8:
            raise DisagreementError(f"MuJoCo: the motions differ by {away:.1e}")
        words.append(f"{away:.0e}")
    return ", ".join(words)


def drifts(platform: Platform, q: FloatArray, rates: FloatArray, attitude: FloatArray) -> tuple[float, float]:
    """Return the largest relative changes of T2 and of the inertial angular momentum along one run."""
    energies, momenta = [], []
    for angles, u, (w, *v) in zip(q, rates, attitude, strict=True):
        m = matrices(platform, angles)
        energies.append(0.5 * u @ m.A_star @ u)
        body, axis = (m.A_star @ u + m.B.T @ m.L)[:3], np.array(v)
        momenta.append(body + 2.0 * np.cross(axis, w * body + np.cross(axis, body)))
    T, H = np.array(energies), np.array(momenta)
    return float(np.abs(T / T[0] - 1.0).max()), float(np.linalg.norm(H - H[0], axis=1).max() / np.linalg.norm(H[0]))


def kept() -> str:
    """Return what a million torque-free steps lose, here and in MuJoCo."""
    q, rates = starts(1)
    mujoco = InMujoco(plant())
    lines = ["a million steps of one run change T2, and the inertial angular momentum, by at most (relative)"]
    for step in LENGTHS:
        out = rollout(plant(), q, rates, step=step, steps=1_000_000, every=100_000)
        ours = drifts(plant(), out.q_history[0], out.velocity_history[0], out.attitude_history[0])
        states = [mujoco.states(step, q, rates)]
        for _ in range(10):
            states.append(mujoco.run(states[-1], 100_000)[:, -1])
        theirs = drifts(plant(), *mujoco.motion(np.concatenate(states)))
        lines.append(f"  {step:.0e} s: {ours[0]:.1e} and {ours[1]:.1e}; MuJoCo {theirs[0]:.1e} and {theirs[1]:.1e}")
    return "\n  ".join(lines)


FIRST_CALL = """
import time, numpy as np
from pathlib import Path
from platform_ctrl import read_platform
from platform_ctrl.simulation import rollout
platform = read_platform(Path({model!r}))
began = time.perf_counter()
rollout(platform, np.zeros((1, 5)), np.zeros((1, 8)), step=1e-5, steps=1, threads=1)
print(time.perf_counter() - began)
"""


def first_calls() -> str:
    """Return how long the first call takes in two processes, of which the first one has to compile."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-c", FIRST_CALL.format(model=str(MODEL))]
        times = [
            float(
                subprocess.run(
                    command, check=True, capture_output=True, env=os.environ | {"NUMBA_CACHE_DIR": folder}
                ).stdout
            )
            for _ in range(2)
        ]
    return f"first call in a process: {times[0]:.2f} s with the compilation, {times[1]:.2f} s in the next process"


def kernel() -> Iterator[Comparison]:
    """Compare runs of the three-gyro platform on one thread, per second of the processor."""
    q, rates = starts(RUNS)
    mujoco = InMujoco(plant())
    states = mujoco.states(STEP, q, rates)

    def theirs() -> tuple[InMujoco, FloatArray]:
        return mujoco, mujoco.run(states, STEPS)

    for every, target, note in ((None, 25.0, kept), (1, None, first_calls)):
        yield Comparison(
            name=f"{RUNS} runs of {STEPS:,} steps, {'their ends' if every is None else 'every step recorded'}",
            ours=partial(rollout, plant(), q, rates, step=STEP, steps=STEPS, threads=1, every=every),
            theirs={"mujoco.rollout": theirs},
            target=target,
            check=_same_motion,
            unit="steps/s",
            work=RUNS * STEPS,
            clock="cpu",
            note=note,
        )


def _same_to_the_bit(ours: Any, theirs: Mapping[str, Any]) -> str:
    for other in theirs.values():
        if not (np.array_equal(ours.q, other.q) and np.array_equal(ours.velocity, other.velocity)):
            raise DisagreementError("one thread: another result")
    return "the bit"


def threads() -> Iterator[Comparison]:
    """Compare two threads with one."""
    q, rates = starts(4 * RUNS)
    platform = read_platform(MODEL)
    one, two = (partial(rollout, platform, q, rates, step=STEP, steps=4 * STEPS, threads=k) for k in (1, 2))
    yield Comparison(
        name=f"{4 * RUNS} runs of {4 * STEPS:,} steps, two threads",
        ours=two,
        theirs={"one thread": one},
        target=1.9,
        check=_same_to_the_bit,
        unit="steps/s",
        work=4 * RUNS * 4 * STEPS,
    )


SECTIONS: dict[str, Section] = {"kernel": kernel, "kernel-threads": threads}
