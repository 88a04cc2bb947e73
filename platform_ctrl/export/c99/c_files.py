"""Controllers of a job as C99 source files."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from platform_ctrl.analysis.interconnection import back_calculation
from platform_ctrl.analysis.response import frequency_response
from platform_ctrl.analysis.system import StateSpace, System
from platform_ctrl.common.arguments import one_of
from platform_ctrl.common.files import write_whole
from platform_ctrl.common.text import at_most
from platform_ctrl.common.values import FloatArray, value
from platform_ctrl.design.sections import flattened
from platform_ctrl.errors import InputError, UnscalableError
from platform_ctrl.export.c99.c_text import FILES, Identifiers, field, field_names, rendered
from platform_ctrl.export.c99.code import Code, Number, WrittenController, controllers_of, literal, total
from platform_ctrl.export.systems import signal_units
from platform_ctrl.job.drive import DriveLaw
from platform_ctrl.job.job import Job
from platform_ctrl.job.resolve import Resolver

# Relative change of the response by coefficients in single precision that causes a note, and an error.
_NOTED, _REFUSED = 1e-3, 1e-2
# A pole this little outside the unit circle lies on it.
_ON_CIRCLE = 1e-6


@value
class Written:
    """The files written, and notes."""

    files: tuple[Path, ...]  # Their paths
    notes: tuple[str, ...] = ()  # A line each for what a user should know: rounding, limits without anti-windup


def write_c(
    job: Job,
    entries: Sequence[Mapping[str, Any] | StateSpace],
    folder: str | os.PathLike[str],
    *,
    number: Number = "double",
    sha256: str = "",
    versions: Mapping[str, str] | None = None,
    command: str = "",
) -> Written:
    """Write the controllers of a job as C99: a header and a source file for each, and one pair that runs all.

    Parameters
    ----------
    job
        The job that they belong to.
    entries
        Entries of ``controllers`` in ``result.json``, or `control.StateSpace`, in order of evaluation.
    folder
        Where to; made if it is not there.
    number
        Type of all numbers: ``"double"`` or ``"float"``.
    sha256
        Of the result file, hexadecimal digits, for the headers.
    versions
        ``versions`` of the result file, for the headers.
    command
        The command that writes, for the headers.

    Returns
    -------
    Written
        The files, and what to know about them. The same arguments give the same bytes.

    Raises
    ------
    InputError
        A controller does not fit the job, or the folder cannot be written to.
    ArgumentError
        `number` is another word.
    DesignError
        A controller cannot be written in this number type.
    """
    one_of("number", number, ("double", "float"))
    controllers = controllers_of(job, entries)
    named = [name for one in controllers for name in (*one.inputs, *one.outputs)]
    signals = field_names([*named, *other_inputs(job, named)])
    prefixes = Identifiers(24, FILES)
    units, notes = [], []
    origin = {"Controllers": f"sha256 {sha256}" if sha256 else ""}
    origin |= {"Versions": ", ".join(map(" ".join, (versions or {}).items())), "Made by": command}
    for one in controllers:
        excess, about_windup, left = _anti_windup(one)
        remark, doubt = _in_single_precision(one) if number == "float" else ("", "")
        design = f"{one.design} (method {one.method})" if one.method else one.design
        about = {"Job": job.name, "Plant": job.platform.name, "Loop": one.name, "Design": design}
        units.append(
            Code(
                controller=one,
                excess=excess,
                number=number,
                prefix=prefixes.new(one.name).lower(),
                signals=signals,
                units=signal_units(job.platform, job.units),
                remarks=tuple(text for text in (about_windup, remark) if text),
                origin=about | origin,
            )
        )
        notes += [note for note in (one.note, left, doubt) if note]
    texts = {f"{unit.prefix}.{end}": unit.text(end) for unit in units for end in "hc"}
    prefix = prefixes.new(job.name).lower()
    texts |= job_files(job, prefix, units)
    if job.drives:
        notes.append(f"{prefix}.h: what the drives do is in {prefix}_step, not in the steps of single controllers")
    if job.resolvers:
        notes.append(f"{prefix}.h: readings are turned in {prefix}_step; single controllers take them turned")
    target = Path(folder)
    try:
        target.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"{target}: {why}; name a folder, or a path where one can be made") from None
    return Written(files=tuple(write_whole(target / name, text) for name, text in texts.items()), notes=tuple(notes))


def _anti_windup(one: WrittenController) -> tuple[FloatArray, str, str]:
    """Return E of a controller, a paragraph for the header about it, and a note on what it leaves, or nothing."""
    limited = np.isfinite(one.limits)
    found = back_calculation(one.arrays, limited.tolist())
    if not found.time_constant:
        why = "no state integrates" if limited.any() else "no output is limited"
        return found.gain, f"Anti-windup: none, for {why}.", ""
    remark = (
        "Anti-windup: back-calculation. While a torque is at its limit, the integrals follow what acts with the time "
        f"constant {found.time_constant:.4g} s, the integral time: x+ = A x + B y + E (limited - commanded). "
    )
    k, hidden = found.integrals, found.integrals - found.seen
    if not hidden and found.radius < 1.0:
        stays = f"The states then stay bounded: their slowest pole is |z| = {found.radius:.6g}."
        return found.gain, remark + stays, ""
    left = f"{hidden} of {k} integrating states are not protected against windup: no limited output shows them alone"
    return found.gain, f"{remark}{left}.", f"{one.name}: anti-windup: {left}"


def _in_single_precision(one: WrittenController) -> tuple[str, str]:
    """Return a paragraph for the header about coefficients in single precision, and a note where they change much."""
    change = float_error(one)
    said = f"{one.name}: in single precision the response changes by {change:.2g} of its size"
    if not change <= _REFUSED:
        raise UnscalableError(f"{said}, but {_REFUSED:g} is allowed; use double", one)
    remark = (
        f"Float against double: rounded coefficients change the response by at most {at_most(change, 2)} of its size."
    )
    return remark, said if change > _NOTED else ""


def float_error(one: WrittenController) -> float:
    """Return the largest relative change of a controller's response by coefficients in single precision."""
    K = one.arrays
    largest = max(float(np.abs(item).max(initial=0.0)) for section in one.sections for item in section.block[:4])
    if not max(largest, *one.limits[np.isfinite(one.limits)], 0.0) <= float(np.finfo(np.float32).max):
        raise UnscalableError(f"{one.name}: the number {largest:.3g} does not fit a float; use double", one)

    def single(block: System) -> System:
        A, B, C, D = (item.astype(np.float32).astype(np.float64) for item in block[:4])
        return System(A, B, C, D, block.dt)

    sections = [section._replace(block=single(section.block)) for section in one.sections]
    rounded = flattened(sections, one.inputs, one.outputs)
    # A resonance changes most at its frequency, which a grid misses where it is narrow. The response of an undamped one
    # is not compared there.
    z = np.concatenate([np.linalg.eigvals(item.A) for item in (K, rounded)])
    own = np.abs(np.angle(z[1.0 - np.abs(z) > _ON_CIRCLE]))
    angles = np.concatenate([np.geomspace(1e-7, np.pi, 400), own[own >= 1e-7]])
    before, after = (frequency_response(item, np.unique(angles) / K.dt, -3) for item in (K, rounded))
    size = np.linalg.norm(before, axis=(1, 2))
    # Gains far below the median are not compared.
    size = np.maximum(size, 1e-3 * np.median(size))
    return float((np.linalg.norm(after - before, axis=(1, 2)) / np.where(size > 0.0, size, 1.0)).max())


def job_files(job: Job, prefix: str, units: Sequence[Code]) -> dict[str, str]:
    """Return the texts of the two files by their names."""
    readers: dict[str, Code] = {}  # Signals that no earlier controller computes, by their first reader
    made: dict[str, str] = {}
    steps = []
    every = {unit.prefix: max(round(unit.period / job.sampling.period), 1) for unit in units}
    results = {
        unit.prefix: f"out_{k}" if every[unit.prefix] == 1 else f"state->{unit.prefix}_last"
        for k, unit in enumerate(units, 1)
    }
    laws = job.resolvers
    resolved = {name: f"resolved_{k}[{i}]" for k, law in enumerate(laws, 1) for i, name in enumerate(law.names)}
    for unit in units:
        for name in unit.controller.inputs:
            if name in resolved:
                made[name] = resolved[name]
            elif name not in made:
                readers[name], made[name] = unit, f"in->{unit.signals[name]}"
        taken = [(unit.signals[name], made[name]) for name in unit.controller.inputs]
        given = {name: f"{results[unit.prefix]}.{unit.signals[name]}" for name in unit.controller.outputs}
        made |= {name: f"{result}_commanded" for name, result in given.items()}
        driven = {law.torquer for law in job.drive_laws}
        shown = [(unit.signals[name], result) for name, result in given.items() if name not in driven]
        turned = [k for k, law in enumerate(laws, 1) if set(law.names) & set(unit.controller.inputs)]
        steps.append((unit.prefix, taken, shown, every[unit.prefix], results[unit.prefix], turned))
    held = [one for one, n in every.items() if n > 1]
    cycle = math.lcm(*every.values())
    states = [f"    {one}_state {one};" for one in every]
    states += [f"    {one}_out {one}_last; /* held */\n    unsigned int {one}_status;" for one in held]
    states += [f"    unsigned int {prefix}_sample; /* 0 to {cycle - 1} */"] if held else []
    outputs = [unit.output_field(name) for unit in units for name in unit.controller.outputs]
    number, signals, what = units[0].number, units[0].signals, units[0].units
    inputs = [unit.input_field(name) for name, unit in readers.items()]
    inputs += [field(number, signals[name], what[name]) for name in other_inputs(job, list(made))]
    drives = sorted(job.drive_laws, key=lambda law: [t.name for t in job.platform.torquers].index(law.torquer))
    words = {
        "p": prefix,
        "units": units,
        "every": every,
        "held": held,
        "cycle": cycle,
        "period": job.sampling.period,
        "origin": units[0].origin,
        "operations": np.sum([unit.operations for unit in units], axis=0),
        "drives": [_drive(job, prefix, law, units, results) for law in drives],
        "number": number,
        "resolvers": [_resolver(law, signals, number) for law in laws],
        "largest": "DBL_MAX" if number == "double" else "FLT_MAX",
        "unity": literal(1.0, number),
        "steps": steps,
        "structs": {
            "in": inputs,
            "out": [*outputs, *(f"    unsigned int {one}_status; /* what {one}_step returned */" for one in every)],
            "state": states,
        },
    }
    return {f"{prefix}.{end}": rendered(f"job.{end}.j2", **words) for end in "hc"}


def other_inputs(job: Job, named: Sequence[str]) -> list[str]:
    """Return the sensors that drives and resolvers of a job read beside what is `named`, in the plant's order."""
    used = {name for law in job.drive_laws for name in law.weights}
    used |= {name for law in job.resolvers for name in (*law.read, *law.encoders)}
    return [sensor.name for sensor in job.platform.sensors if sensor.name in used - set(named)]


def _resolver(law: Resolver, signals: Mapping[str, str], number: Number) -> dict[str, Any]:
    """Return the statements that turn readings, and what they do in words, for the template."""
    import sympy
    from sympy.codegen.ast import float32, real
    from sympy.codegen.rewriting import create_expand_pow_optimization

    size, names = len(law.names), range(1, len(law.encoders) + 1)
    products, types = create_expand_pow_optimization(2), {} if number == "double" else {real: float32}
    lines: list[str] = []

    def put(name: str, expression: Any) -> Any:
        """Add a statement unless it is a number, which is returned then, whole numbers as such."""
        plain = sympy.sympify(expression).replace(
            lambda x: x.is_Float and float(x).is_integer(), lambda x: sympy.Integer(int(x))
        )
        if plain.is_Number:
            return plain
        lines.append(f"const {number} {name} = {sympy.ccode(products(plain), type_aliases=types)};")
        return sympy.Symbol(name)

    parts = [sympy.symbols([f"{what}_{k}" for k in names]) for what in ("cosine", "sine")]
    turned, share = (
        sympy.Matrix(size, len(one.T), list(one.flat)).applyfunc(sympy.expand) for one in law.jacobian(*parts)
    )
    for function, own in zip(("cos", "sin"), parts, strict=True):
        for part, name in zip(own, law.encoders, strict=True):
            if turned.has(part) or share.has(part):
                end = "" if number == "double" else "f"
                lines.append(f"const {number} {part} = {function}{end}(in->{signals[name]});")
    J = sympy.Matrix(size, size, lambda i, k: put(f"j_{i + 1}{k + 1}", turned[i, k]))
    det = put("det", J.det())
    room = put("room", law.least**2 - det**2)
    zero = literal(0.0, number)
    lines.append(f"const {number} damping = ({room} > {zero}) ? {room} : {zero};")
    G = J.T * J + sympy.Symbol("damping") * sympy.eye(size)
    upper = {(i, k): put(f"g_{i + 1}{k + 1}", G[i, k]) for k in range(size) for i in range(k + 1)}
    G = sympy.Matrix(size, size, lambda i, k: upper[min(i, k), max(i, k)])
    read, of_root = (
        sympy.Matrix([sympy.Symbol(f"in->{signals[one]}") for one in part]) for part in (law.sensors, law.base)
    )
    own = read - share * of_root if law.base else read
    y = [put(f"y_{k}", one) for k, one in enumerate(own, 1)]
    seen = J.T * sympy.Matrix(y)
    b = [put(f"b_{k + 1}", seen[k]) for k in range(size)]
    whole = put("whole", G.det())
    for k, one in enumerate(G.adjugate() * sympy.Matrix(b)):
        lines.append(f"y[{k}] = {sympy.ccode(products(one / whole), type_aliases=types)};")
    less = f", less what {', '.join(law.base)} show," if law.base else ""
    words = f"{', '.join(law.names)} = {', '.join(law.sensors)}{less} turned to the axes of {', '.join(law.gimbals)}"
    return {"size": size, "lines": lines, "words": words, "limit": f"{law.limit:g}"}


def _drive(job: Job, prefix: str, law: DriveLaw, units: Sequence[Code], results: dict[str, str]) -> dict[str, Any]:
    """Return expressions and constants of the statements of a drive, for the template."""
    number: Number = units[0].number
    own = [unit for unit in units if law.torquer in unit.controller.outputs]
    if not own:
        raise InputError(
            f"drive of {law.torquer!r}: none of these controllers sets this torquer; export them with the one that does"
        )
    unit = own[-1]
    limit = unit.controller.limits[unit.controller.outputs.index(law.torquer)]
    names = [sensor.name for sensor in job.platform.sensors if sensor.name in law.weights]
    reads = [f"in->{unit.signals[name]}" for name in names]
    return {
        "torquer": law.torquer,
        "output": unit.signals[law.torquer],
        "command": f"{results[unit.prefix]}.{unit.signals[law.torquer]}_commanded",
        "limit": literal(limit, number) if np.isfinite(limit) else "",
        "friction": literal(law.friction, number) if law.friction else "",
        "per_rate": literal(1.0 / law.friction_rate, number),
        "products": total([law.weights[name] for name in names], reads, number),
        "tests": [f"{prefix}_usable({one})" for one in reads],
    }
