"""A scheme split into exact rows of stable states, integrals, and their sources with ranges and limits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import flint
import numpy as np

from platform_ctrl.common.arguments import known_names, positive
from platform_ctrl.common.values import value
from platform_ctrl.errors import InfeasibleError, InputError
from platform_ctrl.export.c99.scheme import (
    Rows,
    Scheme,
    Sum,
    added,
    arrays,
    excess_gain,
    excess_of,
    rows_of,
    sections_with_excess,
)
from platform_ctrl.export.fixed_point.exact import (
    characteristic_polynomial,
    exact_system,
    inside_circle,
    joined_states,
    largest_root,
    rational,
)
from platform_ctrl.job.job import Job
from platform_ctrl.plant.platform import OMEGA_NAMES, Platform

# A pole as close to 1 as this is an integral: in a day at 100 Hz it loses less than a percent.
_INTEGRAL = 1e-9
# Pairs of poles in direct form are slow if a1 is as close to 2 as this.
_SLOW = flint.fmpq(1, 2)
# Limits of integrals, over what they need for all torques within the limits.
HEADROOM = 2.0
# Added to a stop, a limit or the operating range: noise, elasticity, offsets.
_MARGIN = 0.1


@value
class Parts:
    """A scheme in exact rows."""

    rows: Rows  # Signals and asymptotically stable states; their sources are inputs, integrals and excesses too
    # What is added to each integral in a step, by its name; excesses, named by excess_of, among the sources
    integrals: dict[str, Sum]
    leaks: dict[str, float]  # How far the poles of integrals lie from 1 in the scheme; here they are 1
    limited: tuple[str, ...]  # Outputs whose excess enters stable states
    excesses: tuple[str, ...]  # Outputs whose excess enters any state
    outputs_read: frozenset[str]  # Outputs that other rows take in
    section: dict[str, str]  # Name of every row's section
    # States that are replaced by their difference to the next one, see _as_differences: their new names
    differences: dict[str, str]

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the asymptotically stable states."""
        return tuple(self.rows.states)


def split_scheme(scheme: Scheme) -> Parts:
    """Return the parts of a scheme."""
    arrays(scheme)
    excess_gain(scheme)
    sections = sections_with_excess(scheme)
    signals, following = rows_of(sections, rational)
    section = {row.target: one.name for one in sections for row in (*one.signals, *one.states)}
    free = (*scheme.inputs, *map(excess_of, scheme.outputs))
    whole = exact_system(Rows(signals, following), free, tuple(following))
    leaks: dict[str, float] = {}
    for group in joined_states(whole.following, whole.states):
        polynomial = characteristic_polynomial(whole.following, group)
        if len(group) == 1 and abs(polynomial[0] + 1) < rational(_INTEGRAL):
            leaks[group[0]] = float(flint.arb(-polynomial[0] - 1))
        elif not inside_circle(polynomial):
            raise InfeasibleError(
                f"fixed point: section {section[group[0]]!r}: a pole has the magnitude "
                f"{largest_root(polynomial):.9g} in z, but must lie inside the unit circle or be a single integrator; "
                "design a stable controller, or export it as double or float",
                scheme,
            )
    differences = _as_differences(signals, following, section)
    integrals = {name: _increment(name, following[name], signals, whole.shown) for name in leaks}
    stable = {name: row for name, row in following.items() if name not in leaks}

    def entering(rows: Iterable[Sum]) -> tuple[str, ...]:
        return tuple(output for output in scheme.outputs if any(excess_of(output) in row for row in rows))

    every = (*signals.values(), *following.values())
    return Parts(
        rows=Rows(signals, stable),
        integrals=integrals,
        leaks=leaks,
        limited=entering(stable.values()),
        excesses=entering([*stable.values(), *integrals.values()]),
        outputs_read=frozenset(name for name in scheme.outputs if any(name in row for row in every)),
        section=section,
        differences=differences,
    )


def _as_differences(signals: dict[str, Sum], following: dict[str, Sum], section: dict[str, str]) -> dict[str, str]:
    """Replace x1 of pairs x1⁺ = a1 x1 + a2 x2 + ..., x2⁺ = x1 with slow poles by d = x1 − x2, in place.

    Then d⁺ = (a1 − 1) d + (a1 + a2 − 1) x2 + ... and x2⁺ = x2 + d. Of poles near 1 the place lies in the last digits of
    a1 and a2, but in the first ones of a1 + a2 − 1, which is their polynomial at 1; and d is small, so that its counts
    are fine.
    """
    one = flint.fmpq(1)
    out: dict[str, str] = {}
    for second, row in list(following.items()):
        plain = [source for source in row if not source.startswith(excess_of(""))]
        if len(plain) != 1 or plain[0] not in following or row[plain[0]] != one:
            continue
        [first] = plain
        if first == second or first in out or second in out or second not in following[first]:
            continue
        if not abs(following[first].get(first, flint.fmpq(0)) - 2) < _SLOW:
            continue
        name = f"{first}_less_{second}"
        while name in section:
            name += "_"
        out[first] = name
        section[name] = section[first]

        def replaced(row: Sum, old: str = first, new: str = name, rest: str = second) -> Sum:
            return added(
                (coefficient, {new: one, rest: one} if source == old else {source: one})
                for source, coefficient in row.items()
            )

        following[name] = added([(one, following.pop(first)), (-one, row)])
        for rows in (signals, following):
            for target in rows:
                rows[target] = replaced(rows[target])
    return out


def _increment(name: str, row: Sum, signals: Mapping[str, Sum], shown: Mapping[str, Sum]) -> Sum:
    """Return what an integral gains in a step: its row with signals that contain it written out, less itself."""
    one = flint.fmpq(1)
    while True:
        inside = [source for source in row if source in signals and name in shown[source]]
        if not inside:
            return {source: coefficient for source, coefficient in row.items() if source != name}
        row = added(
            (coefficient, signals[source] if source in inside else {source: one}) for source, coefficient in row.items()
        )


def input_ranges(inputs: tuple[str, ...], job: Job, ranges: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the largest magnitude of every input: `ranges` as they are, else that of plant and job with a margin.

    An angle reaches its stops, a torque of another controller its torquer's limit, Omega the job's operating range.
    """
    given = dict(ranges or {})
    known = _known(job.platform) | {
        name: float(rate) for name, rate in zip(OMEGA_NAMES, job.Omega, strict=True) if rate > 0.0
    }
    out = {}
    for name in inputs:
        if name in given:
            out[name] = positive(f"ranges[{name!r}]", given[name])
        elif name in known:
            out[name] = (1.0 + _MARGIN) * known[name]
        else:
            raise InputError(
                f"fixed point: no range is known for {name!r}; add stops of its gimbal or a limit of its torquer to "
                f"the plant file, or give its largest magnitude (ranges; on the command line --range {name}=NUMBER)"
            )
    return out


def _known(platform: Platform) -> dict[str, float]:
    out = {
        gimbal.angle: max(abs(stop) for stop in gimbal.stops)
        for gimbal in platform.gimbals
        if gimbal.stops is not None and any(gimbal.stops)
    }
    limits = {torquer.name: torquer.limit for torquer in platform.torquers if torquer.limit}
    return out | limits


def integral_limits(scheme: Scheme, parts: Parts, given: Mapping[str, float] | None) -> dict[str, float]:
    """Return where each integral stops: twice what it needs for any torques within the limits, unless given."""
    given = dict(given or {})
    names = tuple(parts.integrals)
    known_names("limits", list(given), names)
    out = {name: positive(f"limits[{name!r}]", number) for name, number in given.items()}
    if all(name in out for name in names):
        return out
    free = (*scheme.inputs, *names, *(excess_of(output) for output in parts.limited))
    system = exact_system(parts.rows, free, parts.states)
    n = len(parts.states)
    A, B, C, D = (
        np.array([[float(x) for x in row] for row in matrix.tolist()]).reshape(matrix.nrows(), matrix.ncols())
        for matrix in system.balls(names)
    )
    chosen = [system.signals.index(name) for name in scheme.outputs]
    try:
        gain = D[chosen] + C[chosen] @ np.linalg.solve(np.eye(n) - A, B) if n else D[chosen]
        # Singular values that are zero but for rounding do not count.
        inverse = np.linalg.pinv(gain, rcond=1e-9)
    except np.linalg.LinAlgError:
        gain = inverse = np.zeros((len(chosen), len(names)))
    torque = np.array(scheme.torque_limits)
    for j, name in enumerate(names):
        shows = np.abs(gain[:, j]) > 1e-9 * np.abs(gain).max(initial=0.0)
        if name not in out and not (shows.any() and np.all(np.isfinite(torque[shows]))):
            raise InfeasibleError(
                f"fixed point: section {parts.section[name]!r}: no limit is known for the integral {name!r}; add a "
                "limit of the torquer that it drives to the plant file, or give its largest value (limits; on the "
                f"command line --integral-limit {name}=NUMBER)",
                scheme,
            )
    need = np.abs(inverse) @ np.where(np.isfinite(torque), torque, 0.0)
    return {name: out.get(name, HEADROOM * float(need[j])) for j, name in enumerate(names)}
