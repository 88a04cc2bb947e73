"""The terms of the gimbal equations, ranked by their size at an operating point."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from platform_ctrl.common.arguments import instance, known_name, known_names, positive, real_array
from platform_ctrl.common.text import padded, width
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.plant.platform import Platform

if TYPE_CHECKING:
    from platform_ctrl.mechanics.symbolic.derivation import Equations

DROPPED_BY_THE_PAPER = {"Coriolis", "centrifugal", "inertia acceleration", "centrifugal disturbance"}


@value
class Term:
    """One term on the left side of a gimbal's equation.

    Attributes
    ----------
    gimbal
        Name of the gimbal whose equation contains it.
    label
        The term as in (27).
    kind
        What it is: docs/theory/terms.md says how to read it.
    factor
        Its coefficient with the platform's rate in it: of the coordinate or, of a forcing term, the term, SI.
    column, derivative
        The gimbal whose angle it multiplies, and which derivative of it: 0, 1 or 2. None for a forcing term.
    size, share
        Its amplitude at the operating point, N m: the torque that is missing when it is dropped; as a share of the
        largest of its equation.
    sense
        Of a stiffness on the gimbal's own angle: ``"stable"`` or ``"unstable"``.
    kept
        Whether the paper's rule keeps it.
    """

    gimbal: str
    label: str
    kind: str
    factor: float
    column: str | None
    derivative: int | None
    size: float
    share: float
    sense: Literal["stable", "unstable"] | None
    kept: bool


@value
class TermTable:
    """Every term of every gimbal's equation at an operating point.

    Attributes
    ----------
    platform
        The platform.
    Omega, Omega_dot : (3,)
        The platform's rate and its derivative, rad/s, rad/s².
    angles, rates, accelerations : (n,)
        Amplitudes of the gimbals' motion, rad, rad/s, rad/s².
    terms
        Equations in the file's order, the terms of each by falling size.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/theory/terms.md.
    """

    platform: Platform
    Omega: FloatArray
    Omega_dot: FloatArray
    angles: FloatArray
    rates: FloatArray
    accelerations: FloatArray
    terms: tuple[Term, ...]

    def of(self, gimbal: str) -> tuple[Term, ...]:
        """Return the terms of the named gimbal's equation, by falling size."""
        known_name("gimbal", gimbal, self.platform.gimbal_names)
        return tuple(term for term in self.terms if term.gimbal == gimbal)

    def text(self, gimbals: Sequence[str] | None = None, smallest: float = 0.0) -> str:
        """Return the table as aligned text.

        Parameters
        ----------
        gimbals
            Names of those whose equations are wanted, shown in the file's order; default all.
        smallest
            Terms whose share of the largest of their equation is not above this are left out; by default those that are
            zero at the operating point.

        Returns
        -------
        str
            A block for each gimbal.
        """
        names = self.platform.gimbal_names
        lines = []
        for k in known_names("gimbals", names if gimbals is None else gimbals, names):
            shown = [term for term in self.of(names[k]) if term.share > smallest]
            lines.append(f"gimbal {names[k]}: {len(shown)} of {len(self.of(names[k]))} terms")
            cells = [("term", "kind", "N m", "share", "paper", ""), *map(_cells, shown)]
            widths = [max(width(row[column]) for row in cells) for column in range(6)]
            lines += ["  ".join(map(padded, row, widths)).rstrip() for row in cells if shown]
        return "\n".join(lines) or f"platform {self.platform.name!r} has no gimbals: there is no term to rank"


def _cells(term: Term) -> tuple[str, ...]:
    kept = "kept" if term.kept else "dropped"
    return term.label, term.kind, f"{term.size:.2e}", f"{100 * term.share:.3g} %", kept, term.sense or ""


def terms(
    platform: Platform,
    Omega: ArrayLike,
    rates: ArrayLike,
    *,
    frequency: float = 2.0 * math.pi,
    angles: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    Omega_dot: ArrayLike | None = None,
) -> TermTable:
    """Rank every term of every gimbal's equation about zero angles by its size at an operating point.

    The terms are those of (27) and those that the paper drops from it; together they are the exact equations to first
    order in the angles.

    Parameters
    ----------
    platform
        The platform.
    Omega : (3,)
        Rate of the platform, rad/s.
    rates : (n,)
        Amplitudes of the gimbals' rates, rad/s.
    frequency
        Of the motion, rad/s, > 0; default one cycle a second. What follows is derived from it unless given.
    angles, accelerations : (n,)
        Amplitudes; default rates / frequency, rad, and rates × frequency, rad/s².
    Omega_dot : (3,)
        Derivative of the rate; default Omega × frequency, rad/s².

    Returns
    -------
    TermTable
        Ranked equation by equation.

    References
    ----------
    K. Magnus, Ingenieur-Archiv 1976, eq. (27).

    See docs/theory/terms.md.

    Examples
    --------
    >>> import platform_ctrl as pc
    >>> ranked = pc.terms(pc.read_platform("three_gyro_platform"), Omega=(1, 1, 1), rates=[0.01] * 5)
    >>> ranked.of("9")[0].label
    'L11·Ω1'
    """
    n = len(instance("platform", platform, Platform).gimbals)
    frequency = positive("frequency", frequency)
    rate = real_array("Omega", Omega, (3,))
    motion = np.abs(real_array("rates", rates, (n,)))
    deviation = motion / frequency if angles is None else np.abs(real_array("angles", angles, (n,)))
    fast = motion * frequency if accelerations is None else np.abs(real_array("accelerations", accelerations, (n,)))
    change = rate * frequency if Omega_dot is None else real_array("Omega_dot", Omega_dot, (3,))
    from platform_ctrl.mechanics.symbolic.derivation import derived

    found = derived(platform, 1, "exact")
    ranked = []
    for gimbal in platform.gimbal_names:
        row = list(_row(found, gimbal, np.r_[rate, change], (deviation, motion, fast)))
        largest = max((term.size for term in row), default=0.0) or 1.0
        # Sizes that differ by rounding alone keep their order on every machine.
        row.sort(key=lambda term: -float(f"{term.size:.9e}"))
        ranked += [dataclasses.replace(term, share=term.size / largest) for term in row]
    return TermTable(
        platform=platform,
        Omega=rate,
        Omega_dot=change,
        angles=deviation,
        rates=motion,
        accelerations=fast,
        terms=tuple(ranked),
    )


def _row(equations: Equations, gimbal: str, turning: FloatArray, amplitudes: tuple[FloatArray, ...]) -> Iterator[Term]:
    """Go through the terms of a gimbal's equation, their shares not known yet."""
    import sympy

    from platform_ctrl.mechanics.symbolic.writing import text_writer

    write, numbers = text_writer(equations), equations.numbers()
    kinds = {sympy.Symbol(s.name): s.kind for s in equations.symbols}
    root = [*equations.Omega, *equations.Omega_dot]
    variables = [list(some) for some in (equations.q, equations.rates, equations.accelerations)]
    names = equations.platform.gimbal_names
    about_own = "nutation" if equations.platform.rotors else "inertia"
    for coefficient, variable in equations.rows["partially_linear"][names.index(gimbal)]:
        derivative = next((k for k, some in enumerate(variables) if variable in some), None)
        column = None if derivative is None else names[variables[derivative].index(variable)]
        amplitude = 1.0 if derivative is None else float(amplitudes[derivative][names.index(str(column))])
        for powers, form in sympy.Poly(coefficient, *root).terms():
            parts: dict[str, list[object]] = {}
            for part in sympy.Add.make_args(form.as_expr() if hasattr(form, "as_expr") else form):
                symbol = next(iter(part.free_symbols))
                # C is apart from the other inertias where the paper keeps it.
                apart = kinds[symbol] != "axial inertia" or (derivative == 0 and sum(powers[3:]) == 1)
                parts.setdefault(kinds[symbol] if apart else "inertia", []).append(part)
            for of, some in parts.items():
                kind = _kind(of, derivative, sum(powers[3:]), about_own if column == gimbal else "coupling inertia")
                whole = sympy.Add(*some)
                moving = sympy.Mul(*(x**power for x, power in zip(root, powers, strict=True)), variable)
                factor = float(whole.subs(numbers)) * float(np.prod(turning ** np.array(powers)))
                stiff = derivative == 0 and column == gimbal and factor != 0.0
                yield Term(
                    gimbal=gimbal,
                    label=write(whole * moving),
                    kind=kind,
                    factor=factor,
                    column=column,
                    derivative=derivative,
                    size=abs(factor) * amplitude,
                    share=0.0,
                    sense=None if not stiff else "stable" if factor > 0.0 else "unstable",
                    kept=kind not in DROPPED_BY_THE_PAPER,
                )


def _kind(of: str, derivative: int | None, changes: int, inertia: str) -> str:
    """Return the kind of a term with parameters of one sort, and `changes` times Omega'; `inertia` is that of q̈."""
    if of == "element":
        return "force element"
    if of == "momentum":
        return {1: "gyroscopic action", 0: "gyroscopic restraint", None: "gyroscopic disturbance"}[derivative]
    if derivative == 2:
        return inertia
    if derivative == 1:
        return "Coriolis"
    if derivative is None:
        return "acceleration disturbance" if changes else "centrifugal disturbance"
    if not changes:
        return "centrifugal"
    return "rotor acceleration" if of == "axial inertia" else "inertia acceleration"
