"""Lanes that stay the last axis give what `jax.vmap` gives, whatever a function is made of."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from jax.scipy.linalg import solve_triangular

from vibrissa.numerics.trailing import trailing

SIZE = 5


def arithmetic(table: Any, x: Any, k: Any) -> Any:
    """Numbers, vectors and constants of all shapes."""
    turned = jnp.cross(jnp.array([1.0, 2.0, 3.0]), x) + x[0] * jnp.eye(3)[1]
    return jnp.where(x[1] > 0, turned, -x), jnp.clip(x, -0.5, x[2] ** 2), jnp.hypot(x[0], 1.0)


def axes(table: Any, x: Any, k: Any) -> Any:
    """Sums, orders and shapes along axes."""
    outer = x[:, None] * table
    first, second = jnp.split(outer, [1])
    return (
        outer.T.reshape(-1).sum(),
        jnp.cumsum(outer, 1)[::-1],
        jnp.concatenate([first, table, second]).max(0),
        jnp.stack([x[0], jnp.argmin(x).astype(float), 1.0 * k], -1),
        outer @ table.T,
        jnp.pad(x, 1),
    )


def places(table: Any, x: Any, k: Any) -> Any:
    """Entries at places that are known, shared, or each lane's own."""
    return x[1:3], table[k], x[k], table[:, k], x.at[k].set(7.0), x[jnp.argsort(x)]


def loops(table: Any, x: Any, k: Any) -> Any:
    """A walk in which only a part depends on the lane."""

    def step(carry: Any, row: Any) -> Any:
        at, count, total = carry
        return (at + row * x[0], count + 1, total + row.sum()), (at, count)

    last, every = lax.scan(step, (jnp.zeros(4), 0, 0.0), table)
    summed = lax.fori_loop(0, 3, lambda i, sums: sums.at[i].add(x[i] * table[i, 0]), jnp.zeros(3))
    return last, every, summed, lax.fori_loop(0, k, lambda i, far: far + x * i, x)


def until(table: Any, x: Any, k: Any) -> Any:
    """Each lane stops at its own time, all at a common one, and within each other."""

    def root(a: Any) -> Any:
        def better(state: Any) -> Any:
            y, steps = state
            return (y + a / y) / 2, steps + 1

        return lax.while_loop(lambda state: abs(state[0] ** 2 - a) > 1e-12, better, (a + 1, 0))

    together = lax.while_loop(
        lambda state: state[1] < 3, lambda state: (state[0] * x[0], state[1] + 1), (x, 0)
    )
    roots = lax.fori_loop(0, 2, lambda _, y: root(y)[0], jnp.abs(x[0]))
    return root(jnp.abs(x[1])), together, roots


def branches(table: Any, x: Any, k: Any) -> Any:
    """Each lane's own branch, and one for all."""
    of_lane = lax.switch(k, [lambda x: (x, 1.0), lambda x: (2 * x, x[0]), lambda x: (x**2, 0.0)], x)
    of_all = lax.cond(table[0, 0] > 0, lambda x: (x.sum(), 1.0), lambda x: (x[0], 2.0), x)
    return of_lane, of_all


def derived(table: Any, x: Any, k: Any) -> Any:
    """Derivatives, functions with rules of their own, barriers, and what has no rule here."""

    def residual(y: Any) -> Any:
        return y**3 + y - x[0]

    found = lax.custom_root(
        residual,
        jnp.zeros(()),
        lambda of, y: lax.fori_loop(0, 40, lambda _, y: y - of(y) / (3 * y**2 + 1), y),
        lambda linear, right: right / linear(1.0),
    )
    lower = jnp.tril(table[:, :3] + x[0]) + 5 * jnp.eye(3)
    jacobian = jax.jacfwd(lambda x: arithmetic(table, x, k)[0])(x)
    return (
        found,
        jacobian,
        jax.nn.relu(x),
        lax.optimization_barrier((x, table)),
        solve_triangular(lower, x, lower=True),
    )


@pytest.mark.parametrize(
    "function",
    [arithmetic, axes, places, loops, until, branches, derived],
    ids=lambda f: f.__name__,
)
def test_lanes_at_the_end_are_lanes(function: Callable[..., Any]) -> None:
    rng = np.random.default_rng(1)
    table, x = jnp.asarray(rng.normal(size=(3, 4))), jnp.asarray(rng.normal(size=(3, SIZE)))
    k = jnp.array([2, 0, 1, 1, 0])
    axis = (None, -1, -1)
    expected = jax.vmap(function, axis, -1)(table, x, k)
    for run in (trailing(function, SIZE), jax.jit(trailing(function, SIZE))):
        found = run(table, x, k)
        assert jax.tree.structure(found) == jax.tree.structure(expected)
        for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            assert one.dtype == other.dtype
            np.testing.assert_allclose(one, other, rtol=1e-13, atol=1e-14)


def test_lanes_stay_at_the_end_within() -> None:
    """No array between has them elsewhere, and whatever all lanes share has none."""

    def integrated(table: Any, x: Any) -> Any:
        def step(carry: Any, row: Any) -> Any:
            rise = jnp.cross(carry, x) * row.sum() + row[:3]
            return carry / jnp.sqrt(1 + jnp.sum(carry**2)) + rise, None

        return lax.scan(step, x, table)[0]

    size = 17
    closed = jax.make_jaxpr(trailing(integrated, size))(np.ones((6, 4)), np.ones((3, size)))

    scan = next(eqn for eqn in closed.jaxpr.eqns if eqn.primitive.name == "scan")
    inner = [v.aval.shape for eqn in scan.params["jaxpr"].jaxpr.eqns for v in eqn.outvars]
    assert all(size not in shape[:-1] for shape in inner)
    assert () in inner
