"""The section and rest shape of a rod as polynomials in each of its steps."""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.numerics.runge_kutta import Scheme

Scalar = Float[Any, ""]

DEGREE = 4
"""Of the polynomials in which a section is given within each step: the stiffness of a round rod
whose radius changes linearly is one.
"""
POINTS, QUADRATURE = (np.array(np.polynomial.legendre.leggauss(DEGREE + 1)) + [[1], [0]]) / 2
_FIT = np.linalg.inv(np.vander(POINTS, increasing=True))
_THINNEST, _STRAIGHT = 1 - 1e-6, 1e-12
"""Taper up to which the steps are graded further, and logarithm of the tip's share of the radius
below which they are equal, to rounding.
"""


class Local(NamedTuple):
    """A rod at an arc length, or polynomials of it, one row per step."""

    bending: Float[Any, "*s"]
    """B [EI]."""
    torsion: Float[Any, "*s"]
    """B₃ [EI]."""
    rest: Any = None
    """u (…, 3) [1/L]: curvatures about d₁ and d₂, and twist; None for a straight rod."""
    girth: Any = None
    """Radius (…) over that at the clamp; None if it is the same everywhere, or unknown."""
    loaded: Any = None
    """What the load depends on, (…)."""


def fitted(values: Callable[[Any], Any], nodes: Float[Any, "nodes"]) -> Any:
    """Polynomials (steps, 5, …) of functions of the arc length in each step between nodes."""
    s = nodes[:-1, None] + jnp.diff(nodes)[:, None] * POINTS

    def fit(at: Array) -> Array:
        flat = jnp.reshape(at, (*s.shape, -1))
        return jnp.einsum("ij,sjk->sik", _FIT, flat).reshape(at.shape)

    return jax.tree.map(fit, values(s))


def halved(polynomials: Any) -> Any:
    """The same where each step is halved: (2 steps, 5, …)."""
    # p(x) at x = (i + y)/2 as a polynomial in y.
    both = np.array([_FIT @ np.vander((i + POINTS) / 2, increasing=True) for i in (0, 1)])

    def half(part: Array) -> Array:
        return jnp.einsum("hij,sj...->shi...", both, part).reshape(2 * len(part), *part.shape[1:])

    return jax.tree.map(half, polynomials)


def powered(polynomials: Any, power: Scalar) -> Any:
    """Polynomials (steps, 5) of a power of the functions that others stand for."""
    values = polynomials @ np.vander(POINTS, increasing=True).T
    return values**power @ _FIT.T


def padded(nodes: Float[Any, "nodes"], polynomials: Any, steps: int) -> tuple[Array, Any]:
    """Nodes and polynomials with further steps at the tip that have no length."""
    more = steps + 1 - len(nodes)

    def pad(part: Array) -> Array:
        tip = jnp.zeros(part.shape[1:]).at[0].set(jnp.sum(part[-1], axis=0))
        return jnp.concatenate([part, jnp.broadcast_to(tip, (more, *tip.shape))])

    whole = jnp.append(nodes, jnp.broadcast_to(nodes[-1], more))
    return whole, jax.tree.map(pad, polynomials)


class Stage(NamedTuple):
    """What a slope depends on at an arc length, or at the stages of steps."""

    softness: Float[Any, "*s"]
    """1/B [1/EI]."""
    twisting: Float[Any, "*s"]
    """1/B₃ − 1/B [1/EI]."""
    rest: Any
    loaded: Any


def at_stages(polynomials: Local, start: Any, width: Any, nodes: Float[Any, "k"]) -> Stage:
    """Polynomials (5, …) of one step at the stages (k, …) of a part of it."""
    x = start + width * nodes
    square = x * x
    powers = jnp.stack([jnp.ones_like(x), x, square, x * square, square * square], axis=1)

    def at(coefficients: Array) -> Array:
        each = powers.reshape(*powers.shape, *(1,) * (coefficients.ndim - 1))
        return jnp.sum(each * coefficients, axis=1)

    return stage_of(jax.tree.map(at, polynomials))


def stage_of(local: Local) -> Stage:
    """What a slope depends on, from the rod there."""
    soft = 1 / local.bending
    return Stage(soft, 1 / local.torsion - soft, local.rest, local.loaded)


class Steps(NamedTuple):
    """A rod in steps; those that are left over have no length."""

    nodes: Float[Any, "nodes"]
    """Arc lengths [L] at which steps begin and end."""
    local: Local
    """Polynomials (steps, 5, …) in each step."""
    scheme: Scheme
    stages: Stage
    """At the stages of each step (steps, k, …)."""

    @classmethod
    def of(cls, nodes: Array, local: Local, scheme: Scheme) -> "Steps":
        """With stages."""
        stages: Stage = jax.vmap(partial(at_stages, start=0.0, width=1.0, nodes=scheme.nodes))(
            local
        )
        return cls(nodes, local, scheme, stages)

    @property
    def halved(self) -> "Steps":
        """The same with steps of half the length."""
        half = self.nodes[:-1] + jnp.diff(self.nodes) / 2
        nodes = jnp.append(jnp.stack([self.nodes[:-1], half], 1).ravel(), self.nodes[-1])
        return Steps.of(nodes, halved(self.local), self.scheme)


def graded(taper: Scalar, steps: int) -> Float[Any, "nodes"]:
    """Nodes whose distances are as the radius of a rod that is thinner by a fraction `taper` at its
    tip: under the same moment each step bends alike.
    """
    share = np.linspace(0, 1, steps + 1)
    # (1 − (1 − τ)ˣ)/τ, and x for τ → 0.
    thin = jnp.log1p(-jnp.minimum(taper, _THINNEST))
    tiny = abs(thin) < _STRAIGHT
    whole = jnp.where(tiny, 1.0, jnp.expm1(thin))
    return jnp.where(tiny, share, jnp.expm1(share * thin) / whole)
