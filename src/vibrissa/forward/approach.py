"""The straight rod against the object: first contact is geometry, before any mechanics.

The tip may touch first, or the flank, where the rod meets the object tangentially.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.forward.equations import Clamp, Scene, level, levels
from vibrissa.forward.path import clamp_between
from vibrissa.numerics.bracket import bracketed_root
from vibrissa.numerics.compiled import compiled

Scalar = Float[Array, ""]

_SAMPLES = 16
_REFINEMENTS = 16


class Clearance(NamedTuple):
    """How near the straight rod comes to the object."""

    distance: Scalar
    """Smallest first-order distance [L], negative where it enters."""
    arc_length: Scalar
    """Where that is [L]."""
    at_clamp: Scalar
    """Level at the clamp."""


def clearance(scene: Scene, clamp: Clamp) -> Clearance:
    """Clearance of the straight rod.

    The level function is sampled at 17 points; the lowest is refined by Newton's method on its
    derivative along the rod.
    """

    def along(s: Scalar) -> Scalar:
        return level(scene, clamp.point + s * clamp.tangent)

    samples = [jnp.asarray(index / _SAMPLES) for index in range(_SAMPLES + 1)]
    sampled = levels(scene, [clamp.point + sample * clamp.tangent for sample in samples])
    s = _lowest_sample(samples, sampled)
    low, high = jnp.maximum(s - 1 / _SAMPLES, 0.0), jnp.minimum(s + 1 / _SAMPLES, 1.0)
    slope = jax.grad(along)

    def refine(
        _: Array | int, state: tuple[Scalar, Scalar, Scalar]
    ) -> tuple[Scalar, Scalar, Scalar]:
        # Newton's method for the zero of the slope, held in a bracket by bisection.
        s, low, high = state
        first, second = jax.jvp(slope, (s,), (jnp.ones_like(s),))
        low, high = jnp.where(first < 0, s, low), jnp.where(first < 0, high, s)
        target = s - first / jnp.where(second > 0, second, 1.0)
        return (
            jnp.where((second > 0) & (target > low) & (target < high), target, (low + high) / 2),
            low,
            high,
        )

    refined, _, _ = lax.fori_loop(0, _REFINEMENTS, refine, (s, low, high))
    if scene.surface.heavy:
        return Clearance(*_nearer_in_loop(scene, clamp, jnp.stack([refined, s])), sampled[0])
    s = jnp.where(along(refined) <= along(s), refined, s)
    value, gradient = jax.value_and_grad(level, argnums=1)(scene, clamp.point + s * clamp.tangent)
    return Clearance(value / jnp.sqrt(jnp.sum(gradient * gradient)), s, sampled[0])


def _lowest_sample(samples: list[Scalar], values: list[Scalar]) -> Scalar:
    best, lowest = samples[0], values[0]
    for s, value in zip(samples[1:], values[1:], strict=True):
        lower = value < lowest
        best, lowest = jnp.where(lower, s, best), jnp.where(lower, value, lowest)
    return best


def _nearer_in_loop(
    scene: Scene, clamp: Clamp, lengths: Float[Array, "2"]
) -> tuple[Scalar, Scalar]:
    values, gradients = lax.map(
        lambda s: jax.value_and_grad(level, argnums=1)(scene, clamp.point + s * clamp.tangent),
        lengths,
    )
    distances = values / jnp.sqrt(jnp.sum(gradients * gradients, axis=-1))
    first = values[0] <= values[1]
    return jnp.where(first, distances[0], distances[1]), jnp.where(first, lengths[0], lengths[1])


@compiled
def clearances(
    scene: Scene, point: Float[Array, "blocks 3 width"], tangent: Float[Array, "blocks 3 width"]
) -> Float[Array, "blocks 2 width"]:
    """Clearance of the straight rod and level at the clamp, for blocks of poses."""

    def one(point: Float[Array, "3"], tangent: Float[Array, "3"]) -> Float[Array, "2"]:
        found = clearance(scene, Clamp(point, tangent))
        return jnp.stack([found.distance, found.at_clamp])

    return lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block), (point, tangent))


@compiled
def first_contacts(
    scene: Scene,
    stretches: Float[Array, "blocks 14 width"],
    distances: Float[Array, "blocks 2 width"],
) -> Float[Array, "blocks 6 width"]:
    """First contact on stretches of the path, given the straight rod's clearance at their ends:
    clear at the start, not at the end.

    Returns the fraction of the stretch, the contact point [L] (3), the arc length [L], and the
    cosine between normal and rod: −1 is head-on.
    """

    def one(ends: Float[Array, "14"], distances: Float[Array, "2"]) -> Float[Array, "6"]:
        def distance(fraction: Scalar, _: Scalar) -> tuple[Scalar, Scalar]:
            found = clearance(scene, clamp_between(ends, fraction))
            return found.distance, found.arc_length

        zero, full = jnp.zeros(()), jnp.ones(())
        fraction, s = bracketed_root(
            distance, (zero, full), (distances[0], distances[1]), (zero, zero)
        )
        clamp = clamp_between(ends, fraction)
        point = clamp.point + s * clamp.tangent
        gradient = jax.grad(level, argnums=1)(scene, point)
        cosine = jnp.dot(gradient, clamp.tangent) / jnp.sqrt(jnp.sum(gradient * gradient))
        return jnp.concatenate([jnp.stack([fraction]), point, jnp.stack([s, cosine])])

    return lax.map(
        lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block), (stretches, distances)
    )
