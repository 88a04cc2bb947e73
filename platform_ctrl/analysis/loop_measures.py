"""What a controller makes of a plant set: the figures that requirements ask for."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import field

import numpy as np

from platform_ctrl.analysis.arrays import StateArrays, state_space
from platform_ctrl.analysis.bandwidth import bandwidth, bandwidth_of_response
from platform_ctrl.analysis.channel import Channel
from platform_ctrl.analysis.loop_figures import OF_CONTROLLER, PEAKS, Asked, LoopFigures
from platform_ctrl.analysis.norms import noise_rms_arrays
from platform_ctrl.analysis.plant_set import BoolArray, Group, PlantSet, members
from platform_ctrl.errors import ArgumentError
from platform_ctrl.frozen import FloatArray, value

# A figure by what makes it: its kind, the edge of its band, the signals between which it is taken.
Key = tuple[str, float | None, Channel | None]

# Plants whose peak on the grid lies this near to the worst get the exact norm; the others keep the grid's figure.
_NEAR_WORST = 1.25
# Within these groups the worst plants' disk margins are norms whatever is asked.
_WATCHED: tuple[tuple[str, ...], ...] = (("spread", "Omega"), ("faults",))


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
    further
        Other figures that were asked for, of every plant (N,), or of the controller alone (1,), in SI units.

    References
    ----------
    As `measure`.
    """

    bandwidth: float
    disk_margin: FloatArray
    damping: FloatArray
    decay: FloatArray
    torque_noise: FloatArray
    groups: tuple[Group, ...]
    further: dict[Key, FloatArray] = field(default_factory=dict)

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
        found = self.further.get(_key(asked)) if found is None else found
        if found is None:
            raise ArgumentError(
                f"{asked.kind}: was not measured; expected measure(..., asked=...) with this requirement"
            )
        out: FloatArray = found if asked.kind in OF_CONTROLLER else found[self.of(asked.over)]
        return out


def measure(plants: PlantSet, controller: StateArrays, asked: Sequence[Asked] = ()) -> LoopMeasures:
    """Measure `controller` (u = K y, same period) on every plant, on the set's frequency grid.

    What `LoopMeasures` names is always measured, other figures where `asked` (requirements) need them. Peaks between
    grid points are missed: certify with `exact_measures`.

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

    Notes
    -----
    The arguments are not judged.

    References
    ----------
    See docs/job-file.md.
    """
    return _measured(LoopFigures(plants, controller), asked)


def exact_measures(
    plants: PlantSet, controller: StateArrays, asked: Sequence[Asked] = (), loops: LoopFigures | None = None
) -> LoopMeasures:
    """Return the measures with peaks as norms (not on a grid) wherever they decide anything.

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

    References
    ----------
    As `measure`.
    """
    loops = LoopFigures(plants, controller) if loops is None else loops
    rough = _measured(loops, asked)
    watched = [rough.of(groups) for groups in (("nominal",), *_WATCHED)]
    watched += [rough.of(one.over) for one in asked if one.kind == "disk margin"]
    further = dict(rough.further)
    for one in asked:
        if _key(one) in further and one.kind in PEAKS:
            further[_key(one)] = _refined(loops, one, further[_key(one)], [rough.of(one.over)])
    return dataclasses.replace(
        rough,
        bandwidth=_nominal_bandwidth(plants, controller),
        disk_margin=_refined(loops, _Own(kind="disk margin"), rough.disk_margin, watched),
        further=further,
    )


def exact_figures(plants: PlantSet, controller: StateArrays, asked: Asked) -> FloatArray:
    """Return one figure as `LoopMeasures.figures` does of `exact_measures`, without measuring anything else."""
    loops = LoopFigures(plants, controller)
    if _nominal_alone(asked):
        if asked.kind == "bandwidth":
            return np.array([_nominal_bandwidth(plants, controller) / (2.0 * np.pi)])
        return _nominal_noise(loops)
    figures = loops.figure(asked)
    if asked.kind in OF_CONTROLLER:
        return figures
    chosen = plants.of(asked.over)
    figures = _refined(loops, asked, figures, [chosen]) if asked.kind in PEAKS else figures
    out: FloatArray = figures[chosen]
    return out


@value
class _Own:
    """A figure that is measured whatever is asked."""

    kind: str
    over: tuple[str, ...] = ()
    frequency: float | None = None
    channel: Channel | None = None


def _measured(loops: LoopFigures, asked: Sequence[Asked]) -> LoopMeasures:
    plants = loops.plants
    further: dict[Key, FloatArray] = {}
    for one in asked:
        if not _nominal_alone(one) and one.kind not in ("stability", "damping", "disk margin"):
            key = _key(one)
            further[key] = further[key] if key in further else loops.figure(one)
    return LoopMeasures(
        bandwidth=float(min(bandwidth_of_response(plants.frequency, S[0]) for S in (loops.S_output, loops.S_input))),
        disk_margin=loops.figure(_Own(kind="disk margin")),
        damping=loops.figure(_Own(kind="damping")),
        decay=loops.decay,
        torque_noise=_nominal_noise(loops),
        groups=plants.groups,
        further=further,
    )


def _refined(loops: LoopFigures, asked: Asked, figures: FloatArray, watched: Sequence[BoolArray]) -> FloatArray:
    """Return figures that peak with those near the worst of each watched part as norms."""
    # A margin is the inverse of a peak.
    inverse = asked.kind == "disk margin"
    with np.errstate(divide="ignore"):
        peaks = 1.0 / figures if inverse else figures
    out = figures.copy()
    alive = np.isfinite(peaks)
    near = np.zeros(len(figures), dtype=np.bool_)
    for part in watched:
        inside = part & alive
        near |= inside & (peaks * _NEAR_WORST >= peaks[inside].max(initial=0.0))
    for k in np.flatnonzero(near):
        out[k] = loops.exact(asked, int(k))
    return out


def _nominal_bandwidth(plants: PlantSet, controller: StateArrays) -> float:
    K = state_space(controller, plants.angles, plants.torques)
    arrays = StateArrays(plants.A[0], plants.B[0], plants.C[0], plants.D[0], plants.period)
    nominal = state_space(arrays, plants.torques, plants.angles)
    return min(bandwidth(nominal, K, at="input"), bandwidth(nominal, K, at="output"))


def _nominal_noise(loops: LoopFigures) -> FloatArray:
    A, B, C, D, _ = loops.own_arrays
    m = loops.m
    return noise_rms_arrays(A[0], B[0][:, m:], C[0][:m], D[0][:m, m:], loops.plants.noise)


def _key(asked: Asked) -> Key:
    return asked.kind, asked.frequency, asked.channel


def _nominal_alone(asked: Asked) -> bool:
    """Whether it is a figure that `LoopMeasures` keeps for the nominal plant alone, and is asked of it alone."""
    return asked.kind in ("bandwidth", "torque noise") and tuple(asked.over) == ("nominal",)
