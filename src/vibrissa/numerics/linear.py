"""Small dense systems, unrolled: a batch of them compiles to plain vector arithmetic, without a
library call per matrix.
"""

from itertools import combinations

import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.numerics.vectors import dot, joined


def solve_4x4(
    matrix: Float[Array, "4 4"], right: Float[Array, "4"]
) -> tuple[Float[Array, "4"], Float[Array, ""]]:
    """Solution and determinant by Laplace expansion in 2×2 minors of the upper and the lower two
    rows.

    The solution is not finite where the matrix is singular. Relative error about 1e-16 times the
    condition number squared: enough for Newton's method, which recomputes its residual.
    """
    a = [[matrix[i, j] for j in range(4)] for i in range(4)]
    b = [right[i] for i in range(4)]
    (s01, s02, s03, s12, s13, s23), (c01, c02, c03, c12, c13, c23) = (
        [upper[i] * lower[j] - upper[j] * lower[i] for i, j in combinations(range(4), 2)]
        for upper, lower in (a[:2], a[2:])
    )
    determinant = s01 * c23 - s02 * c13 + s03 * c12 + s12 * c03 - s13 * c02 + s23 * c01
    lower = ((c23, c13, c12), (c23, c03, c02), (c13, c03, c01), (c12, c02, c01))
    upper = ((s23, s13, s12), (s23, s03, s02), (s13, s03, s01), (s12, s02, s01))
    columns = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
    values = []
    for unknown in range(4):
        i, j, k = columns[unknown]
        sign = 1.0 if unknown % 2 == 0 else -1.0
        (l0, l1, l2), (u0, u1, u2) = lower[unknown], upper[unknown]
        cofactors = (
            a[1][i] * l0 - a[1][j] * l1 + a[1][k] * l2,
            -(a[0][i] * l0 - a[0][j] * l1 + a[0][k] * l2),
            a[3][i] * u0 - a[3][j] * u1 + a[3][k] * u2,
            -(a[2][i] * u0 - a[2][j] * u1 + a[2][k] * u2),
        )
        values.append(
            sign
            * (
                cofactors[0] * b[0]
                + cofactors[1] * b[1]
                + cofactors[2] * b[2]
                + cofactors[3] * b[3]
            )
        )
    return joined(*values) / determinant, determinant


def solve_3x3(matrix: Float[Array, "3 3"], right: Float[Array, "3"]) -> Float[Array, "3"]:
    """Solution by Cramer's rule."""
    first, second, third = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    across = jnp.cross(second, third)
    values = (
        dot(right, across),
        dot(first, jnp.cross(right, third)),
        dot(first, jnp.cross(second, right)),
    )
    return joined(*values) / dot(first, across)


def solve_pivoted(
    matrix: Float[Array, "n n"], right: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, ""]]:
    """Solution and determinant by Gauss-Jordan elimination with partial pivoting, one loop over the
    columns; not finite where the matrix is singular.
    """
    rows = jnp.arange(len(right))

    def eliminate(column: Array, state: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        matrix, right, determinant = state
        own = rows == column
        entries = jnp.sum(jnp.where(own, matrix, 0.0), axis=1)
        best = rows == jnp.argmax(jnp.where(rows >= column, jnp.abs(entries), -1.0))
        pivot = jnp.sum(jnp.where(best, entries, 0.0))

        def without(part: Array) -> Array:
            """Eliminate the column from all rows but its own, which is swapped into place."""
            of = (slice(None), *(None,) * (part.ndim - 1))
            chosen = jnp.sum(jnp.where(best[of], part, 0.0), axis=0)
            other = jnp.sum(jnp.where(own[of], part, 0.0), axis=0)
            factor = jnp.where(best, jnp.sum(jnp.where(own, entries, 0.0)), entries) / pivot
            left = jnp.where(best[of], other, part) - factor[of] * chosen
            return jnp.where(own[of], chosen / pivot, left)

        swapped = jnp.where(jnp.any(best & own), 1.0, -1.0)
        return without(matrix), without(right), determinant * swapped * pivot

    return lax.fori_loop(0, len(right), eliminate, (matrix, right, jnp.ones(())))[1:]


def solve_small(
    matrix: Float[Array, "n n"], right: Float[Array, "n"]
) -> tuple[Float[Array, "n"], Float[Array, ""]]:
    """Solution and determinant by whichever of these is best for so many unknowns."""
    return (solve_4x4 if matrix.shape[0] == 4 else solve_pivoted)(matrix, right)


def cholesky(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower factor of a positive definite matrix."""
    size = matrix.shape[0]
    rows: list[list[Array]] = []
    for i in range(size):
        row: list[Array] = []
        for j in range(i):
            left = matrix[i, j] - sum((row[k] * rows[j][k] for k in range(j)), jnp.zeros(()))
            row.append(left / rows[j][j])
        row.append(jnp.sqrt(matrix[i, i] - sum((part**2 for part in row), jnp.zeros(()))))
        rows.append(row)
    return jnp.stack([jnp.stack(row + [jnp.zeros(())] * (size - len(row))) for row in rows])


def solve_lower(lower: Float[Array, "n n"], right: Float[Array, "n"]) -> Float[Array, "n"]:
    """Solution with a lower triangular matrix, by forward substitution."""
    values: list[Array] = []
    for i in range(lower.shape[0]):
        known = sum((lower[i, k] * value for k, value in enumerate(values)), jnp.zeros(()))
        values.append((right[i] - known) / lower[i, i])
    return joined(*values)
