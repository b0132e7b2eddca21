"""What an equilibrium means: reactions, energy, and the checks of the state that is returned."""

from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float

from vibrissa.forward.equations import (
    Clamp,
    Scene,
    contact_state,
    is_neutral,
    level,
    levels,
    levels_elsewhere,
    phase_difference,
)
from vibrissa.forward.friction import SIZE, UNKNOWNS, outside_cone, rubbing_state
from vibrissa.mechanics.elastic_line import (
    BEND_POINTS,
    FINE_POINTS,
    bent_part,
    bent_part_finely,
    bent_part_near,
    contact_tangent,
)
from vibrissa.mechanics.elastica import BasePlane, ContactOnRod, bending_energy, largest_curvature
from vibrissa.numerics.compiled import compiled

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
    """At most how deep the elastic line enters the object [L]; rounding where it does not, else
    `closer_blocks` tells.
    """
    contact_tangent: Vector
    plane_normal: Vector
    direction: Vector
    """Unit vector of the contact force on the rod: the normal without friction."""


DEPTH_TOLERANCE = 1e-7
"""Depth [L] up to which the elastic line may enter the object: the error of its points."""

WIDTH = 25
"""Numbers in one assessment, in the order above."""

ENERGY = 11
"""Its column of the energy."""

_DEPTH = 15
_TAIL_POINTS, _FINE_TAIL_POINTS = 9, 193
# Points for one next to the contact; lowest points looked at once more, and with how many points
# between their neighbours.
_CLOSE = 8
_LOWEST, _BETWEEN = 4, 33
# What lies on a quadratic or a straight line from the contact doubles or quadruples from the first
# point to the second.
_LEAST_GROWTH, _MOST_GROWTH = 1.6, 5.0
_ROUNDING = 1e-9


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
    """Reactions, energy and residual of a state at a clamp pose, without the depth: x = (p, f), or
    the eleven numbers of `friction`.
    """
    if x.shape[0] == SIZE:
        rubbing = rubbing_state(scene, x[:UNKNOWNS], clamp)
        n, d, r, plane, rod, steepness = (
            rubbing.normal, rubbing.direction, rubbing.to_contact, rubbing.plane, rubbing.rod, rubbing.steepness,
        )  # fmt: skip
        # The law itself needs the step before; the force's place in the cone does not.
        residual, phase = (
            jnp.max(jnp.abs(rubbing.conditions)) + outside_cone(scene, x[4:UNKNOWNS], n),
            rubbing.phase,
        )
    else:
        state = contact_state(scene, x, clamp)
        n, d, r, plane, rod, steepness = (
            state.normal,
            state.normal,
            state.to_contact,
            state.plane,
            state.rod,
            state.steepness,
        )
        residual, phase = jnp.max(jnp.abs(state.residual)), phase_difference(rod)
    bent = Pushed(x[:3], x[3], n, d, r, plane, rod, steepness)
    return assessment_of(bent, clamp, phase, residual)


class Pushed(NamedTuple):
    """A rod that one force pushes."""

    point: Vector
    force: Scalar
    normal: Vector
    direction: Vector
    to_contact: Vector
    plane: BasePlane
    rod: ContactOnRod
    steepness: Scalar


def assessment_of(
    pushed: Pushed, clamp: Clamp, phase: Scalar, residual: Scalar
) -> tuple[Assessment, Line]:
    """The same of a rod whose equations have been evaluated."""
    f, d, r, rod = pushed.force, pushed.direction, pushed.to_contact, pushed.rod
    # r × F + m0 = 0: one contact carries no couple.
    moment = -f * jnp.cross(r, d)
    side = (r - jnp.dot(r, d) * d) / pushed.plane.lever_arm
    tangent = contact_tangent(d, side, rod)
    across = jnp.cross(clamp.tangent, jnp.where(is_neutral(d, clamp.tangent), side, d))
    plane_normal = across / jnp.sqrt(jnp.sum(across * across))
    assessment = Assessment(
        pushed.point, f, pushed.normal, rod.arc_length, moment, bending_energy(rod, f), largest_curvature(pushed.plane, rod, f), phase,
        residual, jnp.zeros_like(f), tangent, plane_normal, d,
    )  # fmt: skip
    return assessment, Line(pushed.point, f, d, side, tangent, pushed.plane, rod, pushed.steepness)


def _points(line: Line) -> tuple[list[Vector], list[Vector]]:
    """25 points from the contact to the clamp, and 9 from the contact to the tip."""
    p = line.point
    bend = [
        p + advance * line.direction - distance * line.side
        for advance, distance in zip(*bent_part(line.plane, line.rod, line.force), strict=True)
    ]
    rest = jnp.maximum(1 - line.rod.arc_length, 0.0)
    return bend, [
        p + index / (_TAIL_POINTS - 1) * rest * line.tangent for index in range(_TAIL_POINTS)
    ]


def _depth(scene: Scene, line: Line) -> Scalar:
    """At most how deep the rod lies in the object, as far as few of its points tell."""
    bend, tail = _points(line)
    found = levels(scene, bend + tail)
    steepness, s1 = line.steepness, line.rod.arc_length
    # Between points the object may come nearer by half of their distance, which along the bend
    # varies by up to √2.
    near = (
        steepness * s1 / ((BEND_POINTS - 1) * np.sqrt(2)),
        steepness * jnp.maximum(1 - s1, 0.0) / (2 * (_TAIL_POINTS - 1)),
    )
    least = jnp.minimum(_least(found[: len(bend)], near[0]), _least(found[len(bend) :], near[1]))
    if scene.surface.creased:
        least = jnp.minimum(least, _least_close_by(scene, line))
    if scene.surface.parts_count > 1:
        others = levels_elsewhere(scene, bend + tail, line.point)
        least = jnp.minimum(
            least,
            jnp.minimum(
                _least_between(others[: len(bend)], near[0]),
                _least_between(others[len(bend) :], near[1]),
            ),
        )
    return -least / steepness


def _least(levels: list[Scalar], near: Scalar) -> Scalar:
    """Least level of points, lessened by `near` where a point is lower than its neighbours, or
    where the first do not rise as behind a contact.
    """
    first, second = levels[1:3]
    # From a tip as s, from a tangential contact as s².
    rises = (second - _LEAST_GROWTH * first > -_ROUNDING) & (
        _MOST_GROWTH * first - second > -_ROUNDING
    )
    lowest = jnp.minimum(levels[0], first - jnp.where(rises, 0.0, near))
    for before, here, after in zip(levels, levels[1:], levels[2:], strict=False):
        lowest = jnp.minimum(lowest, here - jnp.where(here < jnp.minimum(before, after), near, 0.0))
    return jnp.minimum(lowest, levels[-1] - jnp.where(levels[-1] < levels[-2], near, 0.0))


def _least_between(levels: list[Scalar], near: Scalar) -> Scalar:
    """Least level that a distance can have between points."""
    return reduce(jnp.minimum, [(before + after) / 2 - near for before, after in pairwise(levels)])


def _least_close_by(scene: Scene, line: Line) -> Scalar:
    """The same of points close to the contact, where a crease may hide between the few."""
    advance, distance = bent_part_near(line.plane, line.rod, line.force)
    p, rest = line.point, jnp.maximum(1 - line.rod.arc_length, 0.0)
    bend = [p + a * line.direction - d * line.side for a, d in zip(advance, distance, strict=True)]
    tail = [
        p + index / (_TAIL_POINTS - 1) / _CLOSE * rest * line.tangent for index in range(_CLOSE + 1)
    ]
    found = levels(scene, bend + tail)
    near = (
        line.steepness * line.rod.arc_length / (FINE_POINTS - 1) * np.sqrt(2),
        line.steepness * rest / (2 * _CLOSE * (_TAIL_POINTS - 1)),
    )
    return jnp.minimum(_least(found[: len(bend)], near[0]), _least(found[len(bend) :], near[1]))


def closer(scene: Scene, line: Line) -> Float[Array, "4"]:
    """Deepest of many points of the rod, and its depth [L].

    From below, by up to h²/(8R) for points h ≈ L/6000 apart at the deepest place and an object that
    is round with radius R there, and by h/2 where it is sharp.
    """
    advance, distance = bent_part_finely(line.plane, line.rod, line.force)
    bend = line.point + advance[:, None] * line.direction - distance[:, None] * line.side
    rest = jnp.linspace(0.0, 1.0, _FINE_TAIL_POINTS) * jnp.maximum(1 - line.rod.arc_length, 0.0)
    tail = line.point + rest[:, None] * line.tangent
    # From tip to clamp, with the contact once.
    points = jnp.concatenate([tail[:0:-1], bend])

    def levels_at(points: Float[Array, "n 3"]) -> Float[Array, "n"]:
        def one(point: Vector) -> Scalar:
            return level(scene, point)

        return jnp.asarray(lax.map(one, points) if scene.surface.heavy else jax.vmap(one)(points))

    coarse = levels_at(points)
    padded = jnp.pad(coarse, 1, constant_values=jnp.inf)
    lower = (coarse < padded[:-2]) & (coarse <= padded[2:])
    places = jnp.clip(
        lax.top_k(jnp.where(lower, -coarse, -jnp.inf), _LOWEST)[1], 1, len(points) - 2
    )
    before, here, after = points[places - 1], points[places], points[places + 1]
    t = jnp.linspace(-1.0, 1.0, _BETWEEN)[:, None, None]
    between = (here + t / 2 * (after - before) + t**2 / 2 * (after - 2 * here + before)).reshape(
        -1, 3
    )
    fine = levels_at(between)
    all_points, all_levels = jnp.concatenate([points, between]), jnp.concatenate([coarse, fine])
    lowest = jnp.argmin(all_levels)
    return jnp.append(all_points[lowest], -all_levels[lowest] / line.steepness)


@compiled
def assess_blocks(
    scene: Scene, x: Float[Array, "blocks size width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 25 width"]:
    """Assessments of blocks of states; clamps hold point and tangent."""

    def one(x: Float[Array, "size"], clamp: Float[Array, "6"]) -> tuple[Float[Array, "25"], Line]:
        assessment, line = assess(scene, x, Clamp(clamp[:3], clamp[3:]))
        return jnp.concatenate([jnp.atleast_1d(part) for part in assessment]), line

    fields, lines = lax.map(
        lambda block: jax.vmap(one, in_axes=1, out_axes=(1, -1))(*block), (x, clamps)
    )
    # In a loop of its own, lest XLA evaluate the whole state again for each of the points.
    depths = lax.map(jax.vmap(lambda line: _depth(scene, line), in_axes=-1), lines)
    return jnp.asarray(fields).at[:, _DEPTH].set(depths)


@compiled
def closer_blocks(
    scene: Scene, x: Float[Array, "blocks size width"], clamps: Float[Array, "blocks 6 width"]
) -> Float[Array, "blocks 4 width"]:
    """Deepest points of the elastic lines of states, and how deep they lie in the object [L]: the
    second contact that is missing, if there is one.
    """

    def one(x: Float[Array, "size"], clamp: Float[Array, "6"]) -> Float[Array, "4"]:
        return closer(scene, assess(scene, x, Clamp(clamp[:3], clamp[3:]))[1])

    return lax.map(lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block), (x, clamps))


def assessed(
    scene: Scene, x: Float[np.ndarray, "k size"], clamps: Float[np.ndarray, "k 6"]
) -> tuple[Float[np.ndarray, "k 25"], Float[np.ndarray, "k 3"]]:
    """Assessments of states, their depths looked at closely; and the deepest points [L] of those
    that are deep or nearly so, NaN of the others.
    """
    fields = scene.in_blocks(assess_blocks, x, clamps)
    deepest = np.full((len(x), 3), np.nan)
    left_open = fields[:, _DEPTH] > DEPTH_TOLERANCE
    if left_open.any():
        found = scene.in_blocks(closer_blocks, x[left_open], clamps[left_open])
        fields = fields.copy(order="K")
        deepest[left_open], fields[left_open, _DEPTH] = found[:, :3], found[:, 3]
    return fields, deepest
