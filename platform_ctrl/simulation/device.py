"""Where scenarios are computed: on the processor, or on a CUDA graphics processor with numba-cuda.

Nothing of it is loaded before a run asks for it.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np

from platform_ctrl.common.values import FloatArray
from platform_ctrl.errors import ArgumentError, SimulationError

if TYPE_CHECKING:
    from platform_ctrl.simulation.packing import Packed
    from platform_ctrl.simulation.run_plan import Batch

Device = Literal["cpu", "cuda"]

# Runs that are on the device at a time: far more than it works on at once, far less than its memory.
_RUNS = 1 << 19


def expect_device(device: object) -> None:
    """Refuse a device that cannot be used here."""
    if device not in ("cpu", "cuda"):
        raise ArgumentError(f"device must be 'cpu' or 'cuda', got {device!r}")
    if device == "cuda":
        _cuda()


def processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _cuda() -> Any:
    """Return numba.cuda with a GPU behind it, or its simulator."""
    if not _simulated() and find_spec("numba_cuda") is None:
        raise SimulationError("device 'cuda': numba-cuda is not installed: pip install 'platform_ctrl[cuda]'")
    with _translated_errors():
        cuda = import_module("numba.cuda")
        if not cuda.is_available():
            raise SimulationError("device 'cuda': no CUDA GPU with its driver was found here; use device 'cpu'")
    return cuda


def _simulated() -> bool:
    """Whether numba's CUDA simulator is on (NUMBA_ENABLE_CUDASIM=1)."""
    return bool(import_module("numba").config.ENABLE_CUDASIM)


@contextmanager
def _translated_errors() -> Iterator[None]:
    """What numba-cuda, the driver or the linker object to becomes an error of ours, in one line."""
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*Grid size")  # few runs do not fill a GPU: they need not
            yield
    except SimulationError:
        raise
    except Exception as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        raise SimulationError(f"device 'cuda': {lines[0]}; run it with device 'cpu'") from error


def roll_out(plant: Packed, states: FloatArray, force: FloatArray, step: float, marks: Sequence[int]) -> FloatArray:
    """Return the states (N, S, size), after `marks` steps, of runs with a free root on the GPU.

    Parameters
    ----------
    plant
        The plant.
    states : (N, size), force : (N, 3 + n)
        Where the runs begin, and their [M, Q].
    step, marks
        Step, s; numbers of steps, not falling, after which the states are recorded.
    """
    cuda = _cuda()
    along = np.empty((len(states), len(marks), plant.at.size))
    with _translated_errors():
        from platform_ctrl.simulation.kernel.cuda import THREADS, advance_kernel

        kernel = advance_kernel(plant.links, plant.at)
        constants, around = cuda.to_device(plant.constants), cuda.to_device(plant.around)
        for first in range(0, len(states), _RUNS):
            part = slice(first, first + _RUNS)
            here, acting = (cuda.to_device(np.ascontiguousarray(rows[part])) for rows in (states, force))
            done = 0
            for k, mark in enumerate(marks):
                if mark > done:
                    kernel[math.ceil(here.shape[0] / THREADS), THREADS](
                        constants, around, here, acting, step, mark - done
                    )
                    done = mark
                along[part, k] = here.copy_to_host()
    return along


def batch_metrics_on_cuda(batched: Batch) -> FloatArray:
    """Return the metrics (N, slots) of a batch, computed on the GPU."""
    cuda = _cuda()
    layout = batched.layout
    metrics = np.empty((len(batched.given), layout.end - layout.metrics))
    with _translated_errors():
        from platform_ctrl.simulation.kernel.cuda import THREADS, simulation_kernel

        kernel = simulation_kernel(batched.packed.links, batched.packed.at, layout, batched.free)
        shared = _on_device(cuda, batched.shared)
        record = cuda.to_device(np.zeros((0, 0)))
        for first in range(0, len(metrics), _RUNS):
            part = slice(first, first + _RUNS)
            keys, plants, given = (
                cuda.to_device(np.ascontiguousarray(rows[part]))
                for rows in (batched.keys, batched.plants, batched.given)
            )
            out = cuda.device_array(metrics[part].shape)
            kernel[math.ceil(out.shape[0] / THREADS), THREADS](shared, layout, keys, plants, given, record, out)
            metrics[part] = out.copy_to_host()
    return metrics


_Named = TypeVar("_Named", bound=tuple[Any, ...])


def _on_device(cuda: Any, named: _Named) -> _Named:
    """A named tuple with its arrays on the GPU; in the simulator as it is, for that looks for arrays outside tuples."""
    if _simulated():
        return named
    parts = [cuda.to_device(np.ascontiguousarray(part)) if isinstance(part, np.ndarray) else part for part in named]
    return type(named)(*parts)
