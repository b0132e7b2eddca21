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
from vibrissa.scan.equations import Clamp, Scene, contact_state, levels, phase_difference
from vibrissa.scan.friction import SIZE, UNKNOWNS, outside_cone, rubbing_state

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
    direction: Vector
    """Unit vector of the contact force on the rod: the normal without friction."""


WIDTH = 25
"""Numbers in one assessment, in the order above."""

ENERGY = 11
"""Its column of the energy."""

_DEPTH = 15
_TAIL_POINTS = 9


class Line(NamedTuple):
    """The elastic line, seen from its contact."""

    point: Vector
    force: Scalar
    direction: Vector
    side: Vector
    """Unit vector from the clamp to the line of the force."""
    tangent: Vector
    plane: BasePlane
    rod: ContactOnRod
    steepness: Scalar
    """‖∇g‖ at the contact."""


def assess(scene: Scene, x: Float[Array, "size"], clamp: Clamp) -> tuple[Assessment, Line]:
    """Reactions, energy and residual of a state at a clamp pose, without the depth: x = (p, f), or the eleven numbers of `friction`."""
    if x.shape[0] == SIZE:
        rubbing = rubbing_state(scene, x[:UNKNOWNS], clamp)
        n, d, r, plane, rod, steepness = (
            rubbing.normal, rubbing.direction, rubbing.to_contact, rubbing.plane, rubbing.rod, rubbing.steepness,
        )  # fmt: skip
        # The law itself needs the step before; the force's place in the cone does not.
        residual, phase = jnp.max(jnp.abs(rubbing.conditions)) + outside_cone(scene, x[4:UNKNOWNS], n), rubbing.phase
    else:
        state = contact_state(scene, x, clamp)
        n, d, r, plane, rod, steepness = state.normal, state.normal, state.to_contact, state.plane, state.rod, state.steepness
        residual, phase = jnp.max(jnp.abs(state.residual)), phase_difference(rod)
    f = x[3]
    # r × F + m0 = 0: one contact carries no couple.
    moment = -f * jnp.cross(r, d)
    side = (r - jnp.dot(r, d) * d) / plane.lever_arm
    tangent = contact_tangent(d, side, rod)
    across = jnp.cross(clamp.tangent, d)
    plane_normal = across / jnp.sqrt(jnp.sum(across * across))
    assessment = Assessment(
        x[:3], f, n, rod.arc_length, moment, bending_energy(rod, f), largest_curvature(plane, rod, f), phase, residual, jnp.zeros_like(f),
        tangent, plane_normal, d,
    )  # fmt: skip
    return assessment, Line(x[:3], f, d, side, tangent, plane, rod, steepness)


def _points(line: Line) -> tuple[list[Vector], list[Vector]]:
    """25 points from the contact to the clamp, and 9 from the contact to the tip."""
    p = line.point
    bend = [
        p + advance * line.direction - distance * line.side
        for advance, distance in zip(*bent_part(line.plane, line.rod, line.force), strict=True)
    ]
    rest = jnp.maximum(1 - line.rod.arc_length, 0.0)
    return bend, [p + index / (_TAIL_POINTS - 1) * rest * line.tangent for index in range(_TAIL_POINTS)]


def _depth(scene: Scene, line: Line) -> Scalar:
    """Deepest place of the rod between its points, by parabolas through their minima."""
    bend, tail = _points(line)
    found = levels(scene, bend + tail)
    lowest = jnp.minimum(_lowest(found[: len(bend)]), _lowest(found[len(bend) :]))
    return -lowest / line.steepness


def _deepest(scene: Scene, line: Line) -> Vector:
    """Where that is [L]."""
    best, lowest = line.point, jnp.asarray(jnp.inf)
    for part in _points(line):
        points = jnp.stack(part)
        found = jnp.stack(levels(scene, part))
        middle = jnp.clip(jnp.argmin(found), 1, len(part) - 2)
        before, here, after = (found[middle + offset] for offset in (-1, 0, 1))
        bend = before - 2 * here + after
        share = jnp.clip(jnp.where(bend > 0, (before - after) / (2 * jnp.where(bend > 0, bend, 1.0)), 0.0), -1.0, 1.0)
        value = here + share * (after - before) / 2 + share**2 * bend / 2
        p0, p1, p2 = (points[middle + offset] for offset in (-1, 0, 1))
        place = p1 + share * (p2 - p0) / 2 + share**2 * (p0 - 2 * p1 + p2) / 2
        best, lowest = jnp.where(value < lowest, place, best), jnp.minimum(value, lowest)
    return best


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
    scene: Scene, x: Float[Array, "blocks size width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 25 width"]:
    """Assessments of blocks of states; clamps hold point and tangent."""

    def one(x: Float[Array, "size"], clamp: Float[Array, "6"]) -> tuple[Float[Array, "25"], Line]:
        assessment, line = assess(scene, x, Clamp(clamp[:3], clamp[3:]))
        return jnp.concatenate([jnp.atleast_1d(part) for part in assessment]), line

    fields, lines = lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=(1, -1))(*block), (x, clamps))
    # In a loop of its own, lest XLA evaluate the whole state again for each of the points.
    depths = lax.map(jax.vmap(lambda line: _depth(scene, line), in_axes=-1), lines)
    return jnp.asarray(fields).at[:, _DEPTH].set(depths)


@compiled
def deepest_blocks(
    scene: Scene, x: Float[Array, "blocks size width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 3 width"]:
    """Where the elastic lines of states enter the object most deeply [L]: the second contact that is missing."""

    def one(x: Float[Array, "size"], clamp: Float[Array, "6"]) -> Vector:
        return _deepest(scene, assess(scene, x, Clamp(clamp[:3], clamp[3:]))[1])

    return lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block), (x, clamps))
