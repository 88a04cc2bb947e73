"""What a controller makes of a plant set: the figures that requirements ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import field

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays
from platform_ctrl.analysis.loop_figures import GRIDDED, OF_CONTROLLER, Asked, Key, LoopFigures, Own, key_of
from platform_ctrl.analysis.norms import noise_rms
from platform_ctrl.analysis.plant_set import BoolArray, Group, PlantSet, members
from platform_ctrl.common.signatures import check_arguments
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.errors import ArgumentError

_BANDWIDTH, _DISK_MARGIN, _DAMPING = Own(kind="bandwidth"), Own(kind="disk margin"), Own(kind="damping")


@value
class LoopMeasures:
    """What a controller does to a plant set.

    Attributes
    ----------
    bandwidth
        Nominal: lowest frequency at which the largest singular value of S, at the input or the output, reaches
        1/sqrt(2), rad/s.
    disk_margin : (N,)
        1/‖(S − T)/2‖, all channels at once, the smaller of input and output, dimensionless; 0 where the loop is
        unstable.
    damping : (N,)
        Smallest damping ratio of the closed-loop poles above a tenth of the nutation frequency.
    decay : (N,)
        Decay rate of the slowest closed-loop pole, 1/s; negative where the loop is unstable.
    torque_noise : (m,)
        Nominal rms of the torques from pick-off noise, N m; infinite where the loop is unstable.
    groups
        What each plant stands for, as in `PlantSet`.
    exact
        Whether peaks, bandwidths and margins are taken over all frequencies: the worst of every group of plants that
        something is asked of is then exact, and the others are no worse than it. Else they are the largest at the
        frequencies of a grid.
    further
        Other figures that were asked for, of every plant (N,), or of the controller alone (1,), in SI units.
    """

    bandwidth: float
    disk_margin: FloatArray
    damping: FloatArray
    decay: FloatArray
    torque_noise: FloatArray
    groups: tuple[Group, ...]
    exact: bool = False
    further: dict[Key, FloatArray] = field(default_factory=dict)

    @check_arguments
    def of(self, groups: Sequence[str]) -> BoolArray:
        """Return which plants belong to `groups`, truth values (N,).

        Parameters
        ----------
        groups
            Among ``"nominal"``, ``"spread"``, ``"Omega"`` and ``"faults"``.

        Returns
        -------
        (N,)
            Truth values.

        Notes
        -----
        The arguments are not judged: other names have no members.
        """
        return members(self.groups, groups)

    @check_arguments
    def figures(self, asked: Asked) -> FloatArray:
        """Return what is asked for: a figure of every plant that it is asked of; nominal noise of every torquer.

        Bandwidths in Hz, everything else in SI units.

        Parameters
        ----------
        asked
            A requirement: which figure, of which signals, of which plants.

        Returns
        -------
        (k,)
            Bandwidths in Hz, everything else in SI units.

        Raises
        ------
        ArgumentError
            It was not measured.
        """
        if _nominal_alone(asked):
            return self.torque_noise if asked.kind == "torque noise" else np.array([self.bandwidth / (2.0 * np.pi)])
        own = {"stability": self.decay, "damping": self.damping, "disk margin": self.disk_margin}
        found = own.get(asked.kind)
        found = self.further.get(key_of(asked)) if found is None else found
        if found is None:
            raise ArgumentError(
                f"{asked.kind}: was not measured; expected measure(..., asked=...) with this requirement"
            )
        out: FloatArray = found if asked.kind in OF_CONTROLLER else found[self.of(asked.over)]
        return out


@check_arguments
def measure(plants: PlantSet, controller: StateArrays, asked: Sequence[Asked] = ()) -> LoopMeasures:
    """Measure `controller` (u = K y, same period) on every plant, on the set's frequency grid.

    What `LoopMeasures` names is always measured, other figures where `asked` (requirements) need them. The frequencies
    of closed-loop poles that are narrower than the grid's spacing are looked at as well, and nothing else between grid
    points: judge with `exact_measures`.

    Parameters
    ----------
    plants
        What the controller has to stand.
    controller
        u = K y in the set's order of angles and torques, with its sample period (see `PlantSet.joined`).
    asked
        Requirements whose figures are wanted as well.

    Returns
    -------
    LoopMeasures
        A figure for each plant of the set.

    Raises
    ------
    ArgumentError
        An argument of another kind than annotated.
    """
    return _measured(LoopFigures(plants, controller), asked)


@check_arguments
def exact_measures(
    plants: PlantSet, controller: StateArrays, asked: Sequence[Asked] = (), loops: LoopFigures | None = None
) -> LoopMeasures:
    """Return the measures with peaks, margins and bandwidths over all frequencies wherever they decide anything.

    The worst figure of each group of plants that something is asked of is exact (to 1e-9, from the worse side), and
    the Hamiltonian eigenvalues of every other plant of the group show that its own is no worse.

    Parameters
    ----------
    plants
        What the controller has to stand.
    controller
        u = K y in the set's order of angles and torques, with its sample period (see `PlantSet.joined`).
    asked
        Requirements whose figures are wanted as well.
    loops
        The figures of just this controller and these plants, where they are at hand; what they hold is not worked out
        again.

    Returns
    -------
    LoopMeasures
        As of `measure`, peaks between the grid's points included.

    Raises
    ------
    ArgumentError
        The controller closes an algebraic loop that cannot be solved.
    """
    loops = LoopFigures(plants, controller) if loops is None else loops
    rough = _measured(loops, asked)
    margin = rough.disk_margin
    # Of every group by itself, whatever is asked.
    for group in dict.fromkeys(plants.groups):
        margin = loops.worst(_DISK_MARGIN, margin, rough.of((group,)))
    further = dict(rough.further)
    for one in asked:
        if key_of(one) in further and one.kind in GRIDDED:
            further[key_of(one)] = loops.worst(one, further[key_of(one)], rough.of(one.over))
    return dataclasses.replace(
        rough,
        bandwidth=2.0 * np.pi * loops.exact(_BANDWIDTH, 0),
        disk_margin=margin,
        exact=True,
        further=further,
    )


def exact_figures(plants: PlantSet, controller: StateArrays, asked: Asked) -> FloatArray:
    """Return one figure as `LoopMeasures.figures` does of `exact_measures`, without measuring anything else."""
    loops = LoopFigures(plants, controller)
    if asked.kind == "torque noise" and _nominal_alone(asked):
        return _nominal_noise(loops)
    chosen = plants.of(asked.over)
    figures = loops.figure(asked)
    figures = loops.worst(asked, figures, chosen) if asked.kind in GRIDDED else figures
    out: FloatArray = figures if asked.kind in OF_CONTROLLER else figures[chosen]
    return out


def _measured(loops: LoopFigures, asked: Sequence[Asked]) -> LoopMeasures:
    plants = loops.plants
    further: dict[Key, FloatArray] = {}
    for one in asked:
        if not _nominal_alone(one) and one.kind not in ("stability", "damping", "disk margin"):
            key = key_of(one)
            further[key] = further[key] if key in further else loops.figure(one)
    return LoopMeasures(
        bandwidth=loops.grid_bandwidth(0),
        disk_margin=loops.figure(_DISK_MARGIN),
        damping=loops.figure(_DAMPING),
        decay=loops.decay,
        torque_noise=_nominal_noise(loops),
        groups=plants.groups,
        further=further,
    )


def _nominal_noise(loops: LoopFigures) -> FloatArray:
    A, B, C, D, dt = loops.own_arrays
    m = loops.m
    noise_to_torque = StateArrays(A[0], B[0][:, m:], C[0][:m], D[0][:m, m:], dt)
    return noise_rms(noise_to_torque, loops.plants.noise, allow_unstable=True)


def _nominal_alone(asked: Asked) -> bool:
    """Whether it is a figure that `LoopMeasures` keeps for the nominal plant alone, and is asked of it alone."""
    return asked.kind in ("bandwidth", "torque noise") and tuple(asked.over) == ("nominal",)
