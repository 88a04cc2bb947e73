"""The kernel on a graphics processor: one thread a scenario, the very functions that the processor runs.

numba compiles the functions of the other files for the device too, with a whole number for `lane`. Each thread copies
its scenario into local memory of its own, (slots,), works there, and copies back what has come out. The device keeps
the local memories of neighbouring threads interleaved, so that what a group of threads reads together lies together,
and in its first cache, writes included.

Products and sums are fused where the device's compiler, not LLVM, sees fit: results agree with the processor's to
rounding, not to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platform_ctrl.common.simd import kept
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel.arrays import At, Layout, Links, Shared
from platform_ctrl.simulation.kernel.dynamics import runge_kutta
from platform_ctrl.simulation.kernel.loop import simulate_samples

cuda: Any = import_module("numba.cuda")

# Threads of a block. One uses 160 to 255 registers, so that few blocks are at work on a multiprocessor at a time.
THREADS = 128
# Local memory has a size known when the kernel is compiled: sizes are rounded up to this, so that plants share kernels.
_ROUNDING = 64


def advance_kernel(links: Links, at: At) -> Any:
    """Return the kernel that moves runs of a plant with a free root on.

    Its arguments: constants, around; `states` (N, size), moved in place; their `force` (N, 3 + n); step, steps.
    """
    return _kernel(_advance, links, at, _rounded(at.end))


def simulation_kernel(links: Links, at: At, layout: Layout, free: bool) -> Any:
    """Return the kernel that simulates scenarios of a batch.

    Its arguments: shared, run; `keys` (N, 2); `plants` (N, at.work) and `given` (N, given), what the host gives of
    each; a record without rows; `metrics` (N, metrics), what comes out.
    """
    return _kernel(_simulation, links, at, _rounded(layout.end), free)


def _rounded(slots: int) -> int:
    return -(-slots // _ROUNDING) * _ROUNDING


def _kernel(make: Callable[..., Any], links: Links, at: At, *more: int) -> Any:
    if import_module("numba").config.ENABLE_CUDASIM:
        return cuda.jit(make(links, at, *more))
    from platform_ctrl.simulation.kernel.fixed import Fixed

    return _compiled(make, Fixed(links), Fixed(at), *more)


@cache
def _compiled(make: Callable[..., Any], *known: Any) -> Any:
    try:
        return kept(cuda.jit(cache=True)(make(*known)))
    except RuntimeError:  # nowhere to keep it
        return cuda.jit(make(*known))


def _advance(links: Links, at: At, slots: int) -> Any:
    def advance(
        constants: FloatArray, around: FloatArray, states: FloatArray, force: FloatArray, step: float, steps: int
    ) -> None:
        run = cuda.grid(1)
        if run >= states.shape[0]:
            return
        mem = cuda.local.array(slots, np.float64)
        for i in range(at.end):
            mem[i] = 0.0
        for i in range(constants.shape[0]):
            mem[i] = constants[i]
        for block in range(3):
            row = at.surroundings + block * at.block
            for i in range(around.shape[0]):
                mem[row + i] = around[i]
            for i in range(force.shape[1]):
                mem[row + i] = force[run, i]
        for i in range(at.size):
            mem[at.state + i] = states[run, i]
        for _ in range(steps):
            runge_kutta(links, mem, 0, at, True, False, at.state, step)
        for i in range(at.size):
            states[run, i] = mem[at.state + i]

    return advance


def _simulation(links: Links, at: At, slots: int, free: bool) -> Any:
    def simulation(
        shared: Shared,
        layout: Layout,
        keys: NDArray[np.uint64],
        plants: FloatArray,
        given: FloatArray,
        record: FloatArray,
        metrics: FloatArray,
    ) -> None:
        run = cuda.grid(1)
        if run >= keys.shape[0]:
            return
        mem = cuda.local.array(slots, np.float64)
        for i in range(layout.end):
            mem[i] = 0.0
        for i in range(plants.shape[1]):
            mem[i] = plants[run, i]
        for i in range(given.shape[1]):
            mem[at.end + i] = given[run, i]
        simulate_samples(links, shared, keys[run : run + 1], mem, 0, at, layout, free, 0, layout.samples, record)
        for i in range(metrics.shape[1]):
            metrics[run, i] = mem[layout.metrics + i]

    return simulation
