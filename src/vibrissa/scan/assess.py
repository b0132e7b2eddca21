"""What an equilibrium means: reactions, energy, and the checks of the state that is returned."""

from functools import reduce
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float

from vibrissa.mechanics.elastic_line import bent_part, contact_tangent
from vibrissa.mechanics.elastica import BasePlane, ContactOnRod, bending_energy, largest_curvature
from vibrissa.numerics.compiled import compiled
from vibrissa.scan.equations import Clamp, Scene, contact_state, level, phase_difference

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

_DEPTH = 15
_TAIL_POINTS = 9


class Line(NamedTuple):
    """The elastic line, seen from its contact."""

    point: Vector
    force: Scalar
    normal: Vector
    side: Vector
    """Unit vector from the clamp to the line of the force."""
    tangent: Vector
    plane: BasePlane
    rod: ContactOnRod


def assess(scene: Scene, x: Float[Array, "4"], clamp: Clamp) -> tuple[Assessment, Line]:
    """Reactions, energy and residual of the state x = (p, f) at a clamp pose, without the depth."""
    state = contact_state(scene, x, clamp)
    f, n, r, rod = x[3], state.normal, state.to_contact, state.rod
    # r × F + m0 = 0: one contact carries no couple.
    moment = -f * jnp.cross(r, n)
    side = (r - jnp.dot(r, n) * n) / state.plane.lever_arm
    tangent = contact_tangent(n, side, rod)
    across = jnp.cross(clamp.tangent, n)
    plane_normal = across / jnp.sqrt(jnp.sum(across * across))
    assessment = Assessment(
        x[:3], f, n, rod.arc_length, moment, bending_energy(rod, f), largest_curvature(state.plane, rod, f),
        phase_difference(rod), jnp.max(jnp.abs(state.residual)), jnp.zeros_like(f), tangent, plane_normal,
    )  # fmt: skip
    return assessment, Line(x[:3], f, n, side, tangent, state.plane, rod)


def _depth(scene: Scene, line: Line) -> Scalar:
    """Deepest place of the rod, from 25 points between clamp and contact and 9 between contact and tip, and parabolas through their minima."""
    p = line.point
    bend = [
        p + advance * line.normal - distance * line.side
        for advance, distance in zip(*bent_part(line.plane, line.rod, line.force), strict=True)
    ]
    rest = jnp.maximum(1 - line.rod.arc_length, 0.0)
    tail = [p + index / (_TAIL_POINTS - 1) * rest * line.tangent for index in range(_TAIL_POINTS)]
    levels = _levels(scene, bend + tail)
    lowest = jnp.minimum(_lowest(levels[: len(bend)]), _lowest(levels[len(bend) :]))
    gradient = jax.grad(level, argnums=1)(scene, p)
    return -lowest / jnp.sqrt(jnp.sum(gradient * gradient))


def _levels(scene: Scene, points: list[Vector]) -> list[Scalar]:
    """Written out point by point, so that XLA fuses the whole check; a heavy level goes into a loop, which holds it once."""
    if not scene.surface.heavy:
        return [level(scene, q) for q in points]
    return list(lax.map(lambda q: level(scene, q), jnp.stack(points)))


def _lowest(levels: list[Scalar]) -> Scalar:
    """Least value at equally spaced points, and at the vertices of the parabolas through three of them that lie nearest to the middle one."""
    lowest = reduce(jnp.minimum, levels)
    for before, here, after in zip(levels, levels[1:], levels[2:], strict=False):
        bend = before - 2 * here + after
        vertex = here - (after - before) ** 2 / jnp.where(bend > 0, 8 * bend, 1.0)
        inside = (bend > 0) & (jnp.abs(after - before) < bend)
        lowest = jnp.minimum(lowest, jnp.where(inside, vertex, here))
    return lowest


@compiled
def assess_blocks(
    scene: Scene, x: Float[Array, "blocks 4 width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 22 width"]:
    """Assessments of blocks of states; clamps hold point and tangent."""

    def one(x: Float[Array, "4"], clamp: Float[Array, "6"]) -> tuple[Float[Array, "22"], Line]:
        assessment, line = assess(scene, x, Clamp(clamp[:3], clamp[3:]))
        return jnp.concatenate([jnp.atleast_1d(part) for part in assessment]), line

    fields, lines = lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=(1, -1))(*block), (x, clamps))
    # In a loop of its own, lest XLA evaluate the whole state again for each of the points.
    depths = lax.map(jax.vmap(lambda line: _depth(scene, line), in_axes=-1), lines)
    return jnp.asarray(fields).at[:, _DEPTH].set(depths)
