"""Products of small matrices as plain loops: no BLAS call, quick to compile."""

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import compiled

Array = NDArray[np.float64]


@compiled
def dot(a: Array, b: Array) -> float:
    """Scalar product of two vectors (n,)."""
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled
def apply(A: Array, x: Array) -> Array:
    """A x for A (m, n) and x (n,)."""
    y = np.empty(len(A))
    for i in range(len(A)):
        y[i] = dot(A[i], x)
    return y


@compiled
def apply_transposed(A: Array, x: Array) -> Array:
    """A' x for A (m, n) and x (m,)."""
    y = np.zeros(A.shape[1])
    for i in range(len(A)):
        for j in range(A.shape[1]):
            y[j] += A[i, j] * x[i]
    return y


@compiled
def product(A: Array, B: Array) -> Array:
    """A B for A (m, n) and B (n, p)."""
    C = np.zeros((len(A), B.shape[1]))
    for i in range(len(A)):
        for k in range(len(B)):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@compiled
def gram(A: Array) -> Array:
    """A' A (n, n) for A (m, n)."""
    n = A.shape[1]
    C = np.zeros((n, n))
    for i in range(len(A)):
        for j in range(n):
            for k in range(n):
                C[j, k] += A[i, j] * A[i, k]
    return C
