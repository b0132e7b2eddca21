"""A rod whose tip is caught where two parts of an object meet: both push it there, at one point.

Unknown are the point p, the magnitude f, and the share w of the second part in the force's
direction, d ∝ (1 − w) n_a + w n_b. The conditions are that p lies on both parts, and that the rod,
bent by f d at its tip (mechanics.md, "Uniform straight rod"), reaches it. One force at one point
leaves no couple, so the reactions are those of a single contact, though the touch is none.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float, Int

from vibrissa.forward.assess import (
    DEPTH_TOLERANCE,
    ENERGY,
    WIDTH,
    Assessment,
    Line,
    Pushed,
    assessment_of,
    closer,
)
from vibrissa.forward.equations import Clamp, Scene, bent_by, part_levels, phase_difference
from vibrissa.forward.search import FORCES, seeds_around
from vibrissa.numerics.blocks import AnyArray
from vibrissa.numerics.compiled import compiled

_STEPS = 40
_LONGEST_STEP = 0.2
_SETTLED = 1e-9
# How far [L] from a second part a starting point may lie.
_BESIDE = 0.2
# Of unknowns that are the same.
_DIGITS = 6


class Caught(NamedTuple):
    """Rows of rods caught at their tips: assessments (k, 25), and the outward unit normals of the
    second part (k, 3); NaN where none was found.
    """

    fields: Float[np.ndarray, "k 25"]
    second_normal: Float[np.ndarray, "k 3"]

    @property
    def found(self) -> Bool[np.ndarray, "k"]:
        """Which rows (k,)."""
        return np.isfinite(self.fields[:, ENERGY])


def caught(scene: Scene, clamps: Float[np.ndarray, "k 6"]) -> Caught:
    """The equilibria of least energy of rods that are caught by their tips between two parts and
    lie outside the object, at clamp points and tangents [L].
    """
    fields, second = np.full((len(clamps), WIDTH), np.nan), np.full((len(clamps), 3), np.nan)
    for row, clamp in enumerate(clamps):
        seeds = seeds_around(scene, clamp[:3], clamp[3:], [], FORCES)
        if not len(seeds):
            continue
        levels = scene.in_blocks(_part_levels, seeds[:, :3])
        pairs = np.argsort(levels, axis=1)[:, :2]
        near = np.take_along_axis(levels, pairs[:, 1:], axis=1)[:, 0] < _BESIDE
        if not near.any():
            continue
        starts, pairs = np.column_stack([seeds, np.full(len(seeds), 0.5)])[near], pairs[near]
        solved = scene.in_blocks(_solve, starts, pairs, np.broadcast_to(clamp, (len(starts), 6)))
        sound = (
            (solved[:, 5] < _SETTLED) & (solved[:, 3] > 0) & (solved[:, 4] > 0) & (solved[:, 4] < 1)
        )
        if not sound.any():
            continue
        _, first = np.unique(np.round(solved[sound, :5], _DIGITS), axis=0, return_index=True)
        kept = np.flatnonzero(sound)[first]
        found = scene.in_blocks(
            _assessed, solved[kept], pairs[kept], np.broadcast_to(clamp, (len(kept), 6))
        )
        clear = found[:, 28] < DEPTH_TOLERANCE
        if clear.any():
            best = int(np.argmin(np.where(clear, found[:, ENERGY], np.inf)))
            fields[row], second[row] = found[best, :WIDTH], found[best, WIDTH:28]
    return Caught(fields, second)


@compiled
def _part_levels(
    scene: Scene, points: Float[AnyArray, "blocks 3 width"]
) -> Float[Array, "blocks parts width"]:
    return lax.map(
        jax.vmap(lambda point: part_levels(scene, point), in_axes=1, out_axes=1),
        jnp.asarray(points),
    )


@compiled
def _solve(
    scene: Scene,
    starts: Float[AnyArray, "blocks 5 width"],
    pairs: Int[AnyArray, "blocks 2 width"],
    clamps: Float[AnyArray, "blocks 6 width"],
) -> Float[Array, "blocks 6 width"]:
    """Newton's method: unknowns (5) and residual."""

    def one(
        x: Float[Array, "5"], pair: Int[Array, "2"], clamp: Float[Array, "6"]
    ) -> Float[Array, "6"]:
        at = Clamp(clamp[:3], clamp[3:])

        def conditions(x: Float[Array, "5"]) -> tuple[Float[Array, "5"], Float[Array, "5"]]:
            levels, _, normals = _pair(scene, x[:3], pair)
            bent = bent_by(_direction(x[4], normals), x[:4], at)
            residual = jnp.concatenate(
                [levels, jnp.stack([bent.out_of_plane, bent.misses, 1 - bent.rod.arc_length])]
            )
            return residual, residual

        def iterate(_: Array | int, x: Float[Array, "5"]) -> Float[Array, "5"]:
            jacobian, residual = jax.jacfwd(conditions, has_aux=True)(x)
            step = jnp.linalg.solve(jacobian, residual)
            longest = jnp.max(jnp.abs(step[jnp.array([0, 1, 2, 4])]))
            return x - jnp.minimum(1.0, _LONGEST_STEP / jnp.maximum(longest, _LONGEST_STEP)) * step

        x = lax.fori_loop(0, _STEPS, iterate, x)
        residual = jnp.max(jnp.abs(conditions(x)[0]))
        return jnp.append(x, residual)

    return lax.map(
        lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block),
        (jnp.asarray(starts), jnp.asarray(pairs), jnp.asarray(clamps)),
    )


@compiled
def _assessed(
    scene: Scene,
    x: Float[AnyArray, "blocks 6 width"],
    pairs: Int[AnyArray, "blocks 2 width"],
    clamps: Float[AnyArray, "blocks 6 width"],
) -> Float[Array, "blocks 29 width"]:
    """Assessments (25), the second part's normal (3), and how deep the rod lies in the object
    anywhere.
    """

    def one(
        x: Float[Array, "6"], pair: Int[Array, "2"], clamp: Float[Array, "6"]
    ) -> Float[Array, "29"]:
        assessment, line = _pushed(scene, x[:5], pair, Clamp(clamp[:3], clamp[3:]), x[5])
        fields = jnp.concatenate([jnp.atleast_1d(part) for part in assessment])
        return jnp.concatenate([fields, _pair(scene, x[:3], pair)[2][1], closer(scene, line)[3:]])

    return lax.map(
        lambda block: jax.vmap(one, in_axes=1, out_axes=1)(*block),
        (jnp.asarray(x), jnp.asarray(pairs), jnp.asarray(clamps)),
    )


def _pair(
    scene: Scene, point: Float[Array, "3"], pair: Int[Array, "2"]
) -> tuple[Float[Array, "2"], Float[Array, "2 3"], Float[Array, "2 3"]]:
    """Levels, their gradients and unit normals of two parts."""
    gradients = jax.jacfwd(lambda point: part_levels(scene, point))(point)[pair]
    return (
        part_levels(scene, point)[pair],
        gradients,
        gradients / jnp.sqrt(jnp.sum(gradients**2, axis=1, keepdims=True)),
    )


def _direction(share: Float[Array, ""], normals: Float[Array, "2 3"]) -> Float[Array, "3"]:
    blend = (1 - share) * normals[0] + share * normals[1]
    return blend / jnp.sqrt(jnp.sum(blend**2))


def _pushed(
    scene: Scene,
    x: Float[Array, "5"],
    pair: Int[Array, "2"],
    clamp: Clamp,
    residual: Float[Array, ""],
) -> tuple[Assessment, Line]:
    """A state assessed, with the first part's normal."""
    _, gradients, normals = _pair(scene, x[:3], pair)
    d = _direction(x[4], normals)
    bent = bent_by(d, x[:4], clamp)
    steepness = jnp.sqrt(jnp.sum(gradients[0] ** 2))
    pushed = Pushed(x[:3], x[3], normals[0], d, bent.to_contact, bent.plane, bent.rod, steepness)
    return assessment_of(pushed, clamp, jnp.minimum(phase_difference(bent.rod), 0.0), residual)
