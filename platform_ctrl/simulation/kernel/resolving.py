"""Readings of body sensors in joint axes, by the angles that encoders read: `platform_ctrl.job.resolve`."""

from __future__ import annotations

from platform_ctrl.common.compiling import internal
from platform_ctrl.common.simd import Number, choose, greater, load, store
from platform_ctrl.common.values import FloatArray
from platform_ctrl.simulation.kernel import arrays
from platform_ctrl.simulation.kernel.arithmetic import cosine_and_sine, put, vector
from platform_ctrl.simulation.kernel.arrays import Layout, Shared


@internal
def resolve(shared: Shared, mem: FloatArray, layout: Layout) -> None:
    """Put resolved readings behind those of the sensors."""
    part = layout.states + shared.targets.shape[0] + 2 * layout.drives + 1 + layout.commands
    number, out = shared.signals.shape[0], layout.sensor + layout.sensors * arrays.SENSOR
    zero = 0.0 * load(mem, layout.start)
    for _ in range(layout.resolvers):
        size, least = shared.first[part], zero + shared.weights[number]
        part, number = part + 1, number + 1
        for i in range(3):
            # Rows and columns that are not there are those of the unit matrix.
            row = layout.turned + arrays.JACOBIAN + 3 * i
            put(mem, row, zero, zero, zero)
            store(mem, row + i, zero + (1.0 if i >= size else 0.0))
            store(mem, layout.turned + arrays.TO_TURN + i, zero)
            store(mem, layout.turned + arrays.ERRORS + i, zero)
        for i in range(size):
            slot, steps = layout.sensor + shared.first[part] * arrays.SENSOR, shared.first[part + 1]
            part += 2
            reading, scale = load(mem, slot + arrays.LAST), load(mem, slot + arrays.SENSOR_SCALE)
            scale = choose((scale < 0.0) | (scale > 0.0), scale, zero + 1.0)
            store(mem, layout.turned + arrays.TO_TURN + i, reading)
            true = (reading - load(mem, slot + arrays.BIAS)) / scale
            store(mem, layout.turned + arrays.ERRORS + i, reading - true)
            a, b, c = shared.weights[number], shared.weights[number + 1], shared.weights[number + 2]
            x, y, z = zero + a, zero + b, zero + c
            number += 3
            for _ in range(steps):
                a, b, c = shared.weights[number], shared.weights[number + 1], shared.weights[number + 2]
                along, column, encoder = a * x + b * y + c * z, shared.first[part], shared.first[part + 1]
                part, number = part + 2, number + 3
                if column >= 0:
                    store(mem, layout.turned + arrays.JACOBIAN + 3 * i + column, along)
                if encoder >= 0:
                    angle = load(mem, layout.sensor + encoder * arrays.SENSOR + arrays.LAST)
                    cosine, sine = cosine_and_sine(angle)
                    rest = (1.0 - cosine) * along
                    x, y, z = (
                        cosine * x + sine * (b * z - c * y) + rest * a,
                        cosine * y + sine * (c * x - a * z) + rest * b,
                        cosine * z + sine * (a * y - b * x) + rest * c,
                    )
        _solve(mem, layout.turned, least, layout.turned + arrays.TO_TURN)
        _solve(mem, layout.turned, least, layout.turned + arrays.ERRORS)
        for i in range(size):
            store(mem, out + arrays.LAST, load(mem, layout.turned + arrays.TO_TURN + i))
            store(mem, out + arrays.BIAS, load(mem, layout.turned + arrays.ERRORS + i))
            out += arrays.SENSOR


@internal
def _solve(mem: FloatArray, turned: int, least: Number, at: int) -> None:
    """Put (JᵀJ + damping 1)⁻¹ Jᵀ y in the place of y, the damping such that gains stay within the limit."""
    a0, a1, a2 = vector(mem, turned + arrays.JACOBIAN)
    b0, b1, b2 = vector(mem, turned + arrays.JACOBIAN + 3)
    c0, c1, c2 = vector(mem, turned + arrays.JACOBIAN + 6)
    det = a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)
    damping = greater(least * least - det * det, 0.0 * det)
    u, v, w = vector(mem, at)
    x, y, z = a0 * u + b0 * v + c0 * w, a1 * u + b1 * v + c1 * w, a2 * u + b2 * v + c2 * w
    g00, g11 = a0 * a0 + b0 * b0 + c0 * c0 + damping, a1 * a1 + b1 * b1 + c1 * c1 + damping
    g22 = a2 * a2 + b2 * b2 + c2 * c2 + damping
    g01, g02, g12 = a0 * a1 + b0 * b1 + c0 * c1, a0 * a2 + b0 * b2 + c0 * c2, a1 * a2 + b1 * b2 + c1 * c2
    m00, m11, m22 = g11 * g22 - g12 * g12, g00 * g22 - g02 * g02, g00 * g11 - g01 * g01
    m01, m02, m12 = g02 * g12 - g01 * g22, g01 * g12 - g02 * g11, g01 * g02 - g00 * g12
    per: Number = 1.0 / (g00 * m00 + g01 * m01 + g02 * m02)
    put(
        mem,
        at,
        per * (m00 * x + m01 * y + m02 * z),
        per * (m01 * x + m11 * y + m12 * z),
        per * (m02 * x + m12 * y + m22 * z),
    )
