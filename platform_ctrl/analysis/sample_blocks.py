"""The recurrence x[k+1] = A x[k] + B u[k], y[k] = C x[k] + D u[k], a block of samples at a time.

The outputs of a block of L samples are O x + T u with the state x before it, the inputs u of the block,
O = [C; C A; C A²; ...] and the Toeplitz matrix T of the impulse response; one product does all blocks. Compiled is what
goes one after another: these matrices, and the states between the blocks.
"""

from __future__ import annotations

import numpy as np

from platform_ctrl.frozen import FloatArray
from platform_ctrl.lanes import compiled, internal


def outputs(
    A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray, u: FloatArray, x0: FloatArray, doublings: int
) -> FloatArray:
    """Return y (p, N) for u (m, N) and x[0] = x0, in blocks of 2**doublings samples."""
    (n, m), p, N, L = B.shape, len(C), u.shape[1], 1 << doublings
    blocks = -(-N // L)
    inputs = np.zeros((blocks * L, m))
    inputs[:N] = u.T
    inputs = inputs.reshape(blocks, L * m)
    # Of rows: the states that outputs see, those that inputs drive, A^L transposed.
    turned = np.array(A.T, order="C")
    seen, driven, within = np.zeros((L * p, n)), np.zeros((L * m, n)), np.zeros((L * m, L * p))
    seen[:p], driven[-m:] = C, B.T
    power = _matrices(np.array(A, order="C"), turned, np.array(D, order="C"), doublings, seen, driven, within)
    x = inputs @ driven
    _between(power, np.array(x0), x)
    y = inputs @ within + x @ seen.T
    return np.ascontiguousarray(y.reshape(blocks * L, p)[:N].T)


@compiled
def _matrices(
    A: FloatArray,
    turned: FloatArray,
    D: FloatArray,
    doublings: int,
    seen: FloatArray,
    driven: FloatArray,
    within: FloatArray,
) -> FloatArray:
    """Go on with `seen` (L p, n), C at its top, and `driven` (L m, n), B transposed at its end; return A^L transposed.

    The inputs of a block have the outputs inputs times `within` (L m, L p) in it.
    """
    p, m = D.shape
    L = 1 << doublings
    for row in range(p, L * p):
        _add_product(seen, row - p, A, seen, row)
    for row in range(L * m - m - 1, -1, -1):
        _add_product(driven, row + m, turned, driven, row)
    for row in range(L):
        for i in range(p):
            for j in range(m):
                within[row * m + j, row * p + i] = D[i, j]
                # The response to the input that is `row` samples old, wherever it came.
                response = 0.0
                if row > 0:
                    for k in range(len(A)):
                        response += seen[(row - 1) * p + i, k] * driven[(L - 1) * m + j, k]
                for column in range(L - row if row > 0 else 0):
                    within[column * m + j, (column + row) * p + i] = response
    power = turned
    for _ in range(doublings):
        square = np.zeros(A.shape)
        for row in range(len(A)):
            _add_product(power, row, power, square, row)
        power = square
    return power


@internal
def _add_product(X: FloatArray, row: int, Y: FloatArray, out: FloatArray, to: int) -> None:
    """Add a row of X times Y to a row of `out`."""
    for k in range(Y.shape[0]):
        factor = X[row, k]
        for j in range(Y.shape[1]):
            out[to, j] += factor * Y[k, j]


@compiled
def _between(power: FloatArray, before: FloatArray, x: FloatArray) -> None:
    """Put the states before the blocks into x (blocks, n), which comes with what the inputs of each block add."""
    blocks, n = x.shape
    after = before.copy()
    for b in range(blocks):
        for i in range(n):
            after[i] = x[b, i]
        # Two at a time: what is added to waits for what was added before.
        for k in range(0, n - 1, 2):
            one, other = before[k], before[k + 1]
            for i in range(n):
                after[i] += power[k, i] * one + power[k + 1, i] * other
        if n % 2:
            for i in range(n):
                after[i] += power[n - 1, i] * before[n - 1]
        for i in range(n):
            x[b, i] = before[i]
            before[i] = after[i]
