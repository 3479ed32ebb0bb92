"""Operations on small matrices in scratch memory: no allocation, no BLAS, quick to compile.

See doc/compiled_code.md for the ownership of scratch memory.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.types import Array


class Scratch(NamedTuple):
    """Stack of numbers for the temporary arrays of a tick; resetting `used` frees them all."""

    numbers: Array
    """(size,)."""
    used: NDArray[np.int64]
    """(1,) count of the numbers in use."""


def make_scratch(size: int) -> Scratch:
    """Return scratch memory for `size` numbers."""
    return Scratch(np.zeros(size), np.zeros(1, np.int64))


@inlined
def vector(scratch: Scratch, n: int) -> Array:
    """Allocate n zeros.

    Raises:
        MemoryError: The scratch memory is too small.
    """
    start = scratch.used[0]
    if start + n > len(scratch.numbers):
        raise MemoryError("scratch memory is too small")
    scratch.used[0] = start + n
    zeros = scratch.numbers[start : start + n]
    for i in range(n):
        zeros[i] = 0.0
    return zeros


@inlined
def matrix(scratch: Scratch, m: int, n: int) -> Array:
    """Allocate (m, n) zeros."""
    return vector(scratch, m * n).reshape(m, n)


@in_place
def dot(a: Array, b: Array) -> float:
    """Return the scalar product of two vectors (n,), as four independent sums for speed."""
    n = len(a)
    s_0, s_1, s_2, s_3 = 0.0, 0.0, 0.0, 0.0
    for i in range(0, n - 3, 4):
        s_0 += a[i] * b[i]
        s_1 += a[i + 1] * b[i + 1]
        s_2 += a[i + 2] * b[i + 2]
        s_3 += a[i + 3] * b[i + 3]
    for i in range(n - n % 4, n):
        s_0 += a[i] * b[i]
    return (s_0 + s_1) + (s_2 + s_3)


@in_place
def cholesky(E: Array, C: Array) -> bool:
    """Fill the lower factor C of E = C C' (n, n); return whether E is positive definite."""
    n = len(E)
    for j in range(n):
        for i in range(j, n):
            rest = E[i, j]
            for k in range(j):
                rest -= C[i, k] * C[j, k]
            if i == j and not rest > 1e-14 * abs(E[j, j]):
                return False
            C[i, j] = math.sqrt(rest) if i == j else rest / C[j, j]
    return True


@in_place
def forward(C: Array, b: Array, n: int, x: Array) -> None:
    """Solve C x = b for the first n rows and columns of a lower triangular C."""
    for i in range(n):
        rest = b[i]
        for j in range(i):
            rest -= C[i, j] * x[j]
        x[i] = rest / C[i, i]


@in_place
def backward(C: Array, b: Array, n: int, x: Array) -> None:
    """Solve C' x = b for the first n rows and columns of a lower triangular C."""
    for i in range(n - 1, -1, -1):
        rest = b[i]
        for j in range(i + 1, n):
            rest -= C[j, i] * x[j]
        x[i] = rest / C[i, i]


@in_place
def project_out(vector: Array, basis: Array, k: int, coordinates: Array, rest: Array) -> None:
    """Split a vector (n,) into coordinates (k,) in the first k rows of a basis, and the rest.

    The rows of the basis are orthonormal.

    Note:
        Gram-Schmidt, repeated if the rest is so short that it has lost digits (Daniel, Gragg,
        Kaufman and Stewart, 1976). The rest is orthogonal to working precision.
    """
    for j in range(len(vector)):
        rest[j] = vector[j]
    for i in range(k):
        coordinates[i] = 0.0
    for _ in range(2):
        before = dot(rest, rest)
        for i in range(k):
            share = dot(basis[i], rest)
            coordinates[i] += share
            for j in range(len(rest)):
                rest[j] -= share * basis[i, j]
        if dot(rest, rest) > 0.5 * before:
            return
