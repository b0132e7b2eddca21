"""What an equilibrium means: reactions, energy, and the checks of the state that is returned."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.mechanics.elastic_line import bent_part, contact_tangent
from vibrissa.mechanics.elastica import bending_energy, largest_curvature
from vibrissa.scan.equations import Clamp, ContactState, Scene, contact_state, level, phase_difference

Scalar = Float[Array, ""]
Vector = Float[Array, "3"]


class Assessment(NamedTuple):
    """One equilibrium in model units; arrays when assessed in a batch."""

    point: Vector
    force: Scalar
    normal: Vector
    arc_length: Scalar
    moment: Vector
    energy: Scalar
    largest_curvature: Scalar
    """Along the rod [1/L]."""
    phase: Scalar
    residual: Scalar
    depth: Scalar
    """Largest depth to which the elastic line enters the object [L], to first order; negative or rounding where it does not."""
    contact_tangent: Vector
    plane_normal: Vector


WIDTH = 22
"""Numbers in one assessment, in the order above."""

_TAIL_POINTS = 9


def assess(scene: Scene, x: Float[Array, "4"], clamp: Clamp) -> Assessment:
    """Reactions, energy and checks of the state x = (p, f) at a clamp pose."""
    state = contact_state(scene, x, clamp)
    f, n, r, rod = x[3], state.normal, state.to_contact, state.rod
    # r × F + m0 = 0: one contact carries no couple.
    moment = -f * jnp.cross(r, n)
    side = (r - jnp.dot(r, n) * n) / state.plane.lever_arm
    tangent = contact_tangent(n, side, rod)
    across = jnp.cross(clamp.tangent, n)
    plane_normal = across / jnp.sqrt(jnp.sum(across * across))
    depth = _depth(scene, x, state, side, tangent)
    return Assessment(
        x[:3], f, n, rod.arc_length, moment, bending_energy(rod, f), largest_curvature(state.plane, rod, f),
        phase_difference(rod), jnp.max(jnp.abs(state.residual)), depth, tangent, plane_normal,
    )  # fmt: skip


def _depth(scene: Scene, x: Float[Array, "4"], state: ContactState, side: Vector, tangent: Vector) -> Scalar:
    """Deepest place of the rod, from 25 points between clamp and contact and 9 between contact and tip, and parabolas through their minima."""
    p = x[:3]
    advance, distance = bent_part(state.plane, state.rod, x[3])
    bend = p + advance[:, None] * state.normal - distance[:, None] * side
    tail = p + (jnp.arange(_TAIL_POINTS) / (_TAIL_POINTS - 1))[:, None] * jnp.maximum(1 - state.rod.arc_length, 0.0) * tangent
    lowest = jnp.minimum(*(_lowest(jax.vmap(lambda q: level(scene, q))(part)) for part in (bend, tail)))
    gradient = jax.grad(level, argnums=1)(scene, p)
    return -lowest / jnp.sqrt(jnp.sum(gradient * gradient))


def _lowest(levels: Float[Array, "points"]) -> Scalar:
    """Least value at equally spaced points, and at the vertices of the parabolas through three of them that lie nearest to the middle one."""
    before, here, after = levels[:-2], levels[1:-1], levels[2:]
    bend = before - 2 * here + after
    vertex = here - (after - before) ** 2 / jnp.where(bend > 0, 8 * bend, 1.0)
    inside = (bend > 0) & (jnp.abs(after - before) < bend)
    return jnp.minimum(jnp.min(levels), jnp.min(jnp.where(inside, vertex, here)))


@jax.jit
def assess_blocks(
    scene: Scene, x: Float[Array, "blocks 4 width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 22 width"]:
    """`assess` for blocks of states; clamps hold point and tangent."""

    def one(x: Float[Array, "4"], clamp: Float[Array, "6"]) -> Float[Array, "22"]:
        parts = assess(scene, x, Clamp(clamp[:3], clamp[3:]))
        return jnp.concatenate([jnp.atleast_1d(part) for part in parts])

    return lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block), (x, clamps))
