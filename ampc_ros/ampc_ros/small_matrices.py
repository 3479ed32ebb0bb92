"""Small matrices as plain loops: no BLAS call, quick to compile."""

import math

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


@compiled
def put(target: Array, source: Array) -> None:
    """Write a vector (n,) into another, longer one from its first place on.

    Note:
        `target[:n] = source` takes seconds to compile, for the text of its error message.
    """
    for i in range(len(source)):
        target[i] = source[i]


@compiled
def cholesky(E: Array) -> tuple[Array, bool]:
    """Lower factor C of E = C C' (n, n), and whether E is positive definite in its digits."""
    n = len(E)
    C = np.zeros((n, n))
    for j in range(n):
        pivot = E[j, j] - dot(C[j, :j], C[j, :j])
        if not pivot > 1e-14 * abs(E[j, j]):
            return C, False
        C[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            C[i, j] = (E[i, j] - dot(C[i, :j], C[j, :j])) / C[j, j]
    return C, True


@compiled
def forward(C: Array, b: Array) -> Array:
    """Solve C x = b for a lower triangular C, whose first len(b) rows and columns count."""
    x = np.empty(len(b))
    for i in range(len(b)):
        x[i] = (b[i] - dot(C[i, :i], x[:i])) / C[i, i]
    return x


@compiled
def backward(C: Array, b: Array) -> Array:
    """Solve C' x = b for a lower triangular C, whose first len(b) rows and columns count."""
    n = len(b)
    x = b.copy()
    for i in range(n - 1, -1, -1):
        x[i] /= C[i, i]
        for j in range(i):
            x[j] -= C[i, j] * x[i]
    return x


@compiled
def project_out(vector: Array, basis: Array) -> tuple[Array, Array]:
    """Part a vector (n,): coordinates (k,) in orthonormal rows (k, n), and what is left (n,).

    Note:
        Gram-Schmidt, done twice, which keeps orthogonality to working precision.
    """
    coordinates = np.zeros(len(basis))
    rest = vector.copy()
    for _ in range(2):
        for i in range(len(basis)):
            share = dot(basis[i], rest)
            coordinates[i] += share
            for j in range(len(rest)):
                rest[j] -= share * basis[i, j]
    return coordinates, rest
