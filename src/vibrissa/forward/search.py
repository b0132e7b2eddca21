"""All equilibria that a search from many starting points finds at one clamp pose: for the rest
after a snap, and for trails that begin in contact.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.forward.assess import DEPTH_TOLERANCE, ENERGY, assessed
from vibrissa.forward.equations import NEUTRAL, Clamp, NewtonStep, Scene, level, newton_step
from vibrissa.numerics.blocks import WIDE, AnyArray, from_blocks, runs, to_blocks
from vibrissa.numerics.compiled import compiled
from vibrissa.surfaces import Offset

_DIRECTIONS = 96
_RAY_SAMPLES = 48
_BESIDE = 0.04
_INWARD = 1e-4
_SIDES = 8
_EVERY = 6
FORCES = (0.05, 0.5, 1.5, 4.0)
# Steps of Newton's method at a time, and how often.
_STEPS, _ROUNDS = 8, 5
# Residual before a step of quadratic convergence that changes nothing more.
_SETTLED = 1e-9
_SAME = 1e-6
# Radius [L] of the thickest rod by whose way an edge is found, and how far [L] from the clamp a
# contact may lie on the way.
_THICKEST = 0.1
_REACH = 1.2
_ASTRAY = 3.0
_MANY = 1024
_SHORTEST = 0.05
# How deep [L] a rod that touches twice may lie in the object at its second contact when it is
# solved for the first alone.
_CAUGHT = 0.15
# Shares of a finite radius behind the place where the rod enters: the way out from there ends on
# all sides of a rounded edge.
_ROUND_AN_EDGE = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95)
_FINER = 33
ENERGY_MARGIN = 1e-9
"""[EI/L] by which a snap loses energy at least, and energies of different equilibria differ."""


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One equilibrium: unknowns x = (p, f), bending energy [EI/L], sign of the Jacobian's
    determinant, and the phase difference.
    """

    x: Float[np.ndarray, "4"]
    energy: float
    determinant: float
    phase: float
    neutral: bool
    """Whether the rod might as well bend to any other side."""


def stable_equilibria(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    tangent: Float[np.ndarray, "3"],
    near: list[Float[np.ndarray, "3"]],
) -> list[Equilibrium]:
    """Admissible stable equilibria found at a clamp pose, lowest energy first; where there are
    none, the one that enters the object least.

    Of equal energies, as of a rod that may bend to any side, the one nearest to the first of the
    points `near` comes first.

    Newton's method starts, with four magnitudes of the force, from the points where rays from the
    clamp meet the object within the rod's length; from where the straight rod lies in it, and a
    little beside that; and from points `near` which a contact is expected.
    """
    seeds = seeds_around(scene, point, tangent, near, FORCES)
    if not len(seeds):
        return []
    clamp = np.concatenate([point, tangent])
    solved = solved_from(scene, eased(scene, seeds, clamp), clamp).distinct(clamp)
    stable = solved.determinant < 0
    x, determinant = solved.x[stable], solved.determinant[stable]
    if not len(x):
        return []
    fields, _ = assessed(scene, x, np.broadcast_to(clamp, (len(x), 6)))
    arc_length, energy, phase, residual, depth = (
        fields[:, column] for column in (7, ENERGY, 13, 14, 15)
    )
    good = (
        (residual < DEPTH_TOLERANCE)
        & (depth < DEPTH_TOLERANCE)
        & (arc_length < 1 + DEPTH_TOLERANCE)
    )
    if not good.any():
        # A rod that is caught touches twice: the equilibrium of one contact that comes nearest to
        # that, which its assessment says.
        caught = (
            (residual < DEPTH_TOLERANCE) & (depth < _CAUGHT) & (arc_length < 1 + DEPTH_TOLERANCE)
        )
        good = caught & (depth == depth[caught].min(initial=np.inf))
    rows = np.flatnonzero(good)
    away = (
        np.linalg.norm(x[rows, :3] - np.reshape(near, (-1, 3))[:1], axis=1)
        if near
        else np.zeros(len(rows))
    )
    least = energy[rows].min(initial=np.inf)
    order = np.lexsort((away, np.where(energy[rows] < least + ENERGY_MARGIN, least, energy[rows])))
    neutral = np.linalg.norm(np.cross(tangent, fields[:, 22:25]), axis=1) < NEUTRAL
    return [
        Equilibrium(
            x[row],
            float(energy[row]),
            float(determinant[row]),
            float(phase[row]),
            bool(neutral[row]),
        )
        for row in rows[order]
    ]


def seeds_around(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    tangent: Float[np.ndarray, "3"],
    near: list[Float[np.ndarray, "3"]],
    forces: tuple[float, ...],
) -> Float[np.ndarray, "seeds 4"]:
    """Starting points (p, f) for Newton's method: where rays from the clamp enter the object, and
    around expected places, with several magnitudes of the force.
    """
    # A Fibonacci spiral over the directions within 105° of the tangent.
    order = np.arange(_DIRECTIONS) + 0.5
    cosine = 1 - 1.25 * order / _DIRECTIONS
    azimuth = np.pi * (1 + np.sqrt(5)) * order
    first = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent))])
    first /= np.linalg.norm(first)
    second = np.cross(tangent, first)
    sine = np.sqrt(1 - cosine**2)
    rays = (
        cosine[:, None] * tangent
        + (sine * np.cos(azimuth))[:, None] * first
        + (sine * np.sin(azimuth))[:, None] * second
    )
    distance = np.arange(1, _RAY_SAMPLES + 1) / _RAY_SAMPLES
    values = _levels(scene, point + distance[None, :, None] * rays[:, None, :])
    enters = (values[:, 1:] < 0) & (values[:, :-1] >= 0)
    ray, sample = np.nonzero(enters)
    meets = _crossing(values, ray, sample, distance)
    along = point + distance[:, None] * tangent
    own = _levels(scene, along[None])
    inside = along[own[0] < 0]
    expected = np.concatenate([np.reshape(near, (-1, 3)), inside])
    around = expected[:, None] + _BESIDE * np.stack([0 * first, first, -first, second, -second])
    # Where the straight rod enters the object, and where it lies in it: out of it sideways.
    step = np.flatnonzero((own[0, 1:] < 0) & (own[0, :-1] >= 0))
    depths = np.array(
        [
            _INWARD,
            *(
                np.array(_ROUND_AN_EDGE) * scene.surface.radius / scene.length
                if isinstance(scene.surface, Offset)
                else []
            ),
        ]
    )
    entered = _entered(scene, point, tangent, distance[step], distance[step + 1])
    entries = point + (entered[:, None] + depths).reshape(-1, 1) * tangent
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    sideways = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    beside = _way_out(scene, np.concatenate([entries, inside[::_EVERY]]), sideways)
    points = np.concatenate([point + meets[:, None] * rays[ray], around.reshape(-1, 3), beside])
    seeds = [np.column_stack([points, np.full(len(points), force)]) for force in forces]
    if len(beside):
        # Just behind a first contact: the force that bends a cantilever sideways to there.
        to_there = beside - point
        reach = np.maximum(to_there @ tangent, _SHORTEST)
        aside = np.linalg.norm(to_there - (to_there @ tangent)[:, None] * tangent, axis=1)
        seeds.append(np.column_stack([beside, np.minimum(3 * aside / reach**3, forces[-1])]))
    return np.concatenate(seeds)


def _crossing(
    values: Float[np.ndarray, "rays samples"],
    ray: Int[np.ndarray, "k"],
    sample: Int[np.ndarray, "k"],
    distance: Float[np.ndarray, "samples"],
) -> Float[np.ndarray, "k"]:
    """Distances at which levels change their sign behind given samples, by interpolation."""
    before, after = values[ray, sample], values[ray, sample + 1]
    return np.asarray(distance[sample] + before / (before - after) * (distance[1] - distance[0]))


def _entered(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    tangent: Float[np.ndarray, "3"],
    low: Float[np.ndarray, "k"],
    high: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "k"]:
    """Arc lengths at which the straight rod enters the object, between one outside and one inside:
    exactly enough for the edge of a thin rod's offset.
    """
    share = np.linspace(0, 1, _FINER)
    for _ in range(2 if len(low) else 0):
        samples = low[:, None] + (high - low)[:, None] * share
        first = np.argmax(_levels(scene, point + samples[..., None] * tangent) < 0, axis=1)
        rows = np.arange(len(low))
        low, high = samples[rows, np.maximum(first, 1) - 1], samples[rows, np.maximum(first, 1)]
    return high


def _way_out(
    scene: Scene, bases: Float[np.ndarray, "bases 3"], sideways: Float[np.ndarray, "sides 3"]
) -> Float[np.ndarray, "k 3"]:
    """Where rays from points inside the object leave it, within half a rod length."""
    if not len(bases):
        return np.zeros((0, 3))
    distance = np.arange(_RAY_SAMPLES // 2 + 1) / _RAY_SAMPLES
    starts, directions = np.repeat(bases, len(sideways), axis=0), np.tile(sideways, (len(bases), 1))
    values = _levels(scene, starts[:, None] + distance[None, :, None] * directions[:, None])
    ray, sample = np.nonzero((values[:, :-1] < 0) & (values[:, 1:] >= 0))
    return np.asarray(
        starts[ray] + _crossing(values, ray, sample, distance)[:, None] * directions[ray]
    )


def _levels(
    scene: Scene, points: Float[np.ndarray, "rays samples 3"]
) -> Float[np.ndarray, "rays samples"]:
    return scene.in_blocks(_level_blocks, points.reshape(-1, 3), width=_MANY)[:, 0].reshape(
        points.shape[:2]
    )


@compiled
def _level_blocks(
    scene: Scene, points: Float[AnyArray, "blocks 3 width"]
) -> Float[Array, "blocks 1 width"]:
    return lax.map(
        lambda block: jax.vmap(lambda point: level(scene, point), in_axes=1)(block)[None],
        jnp.asarray(points),
    )


class Solved(NamedTuple):
    """Where Newton's method ended: states (n, 4), the Jacobian's determinants there, and the
    residuals before the last step.
    """

    x: Float[np.ndarray, "n 4"]
    determinant: Float[np.ndarray, "n"]
    residual: Float[np.ndarray, "n"]

    def distinct(self, clamp: Float[np.ndarray, "6"]) -> "Solved":
        """Converged contacts that push and lie near the clamp, each once."""
        sound = (
            (self.residual < _SETTLED)
            & (self.x[:, 3] > 0)
            & (np.abs(self.x[:, :3] - clamp[:3]).max(axis=1) < _REACH)
        )
        rows = np.flatnonzero(sound)
        kept: list[int] = []
        while rows.size:
            kept.append(int(rows[0]))
            rows = rows[np.abs(self.x[rows] - self.x[rows[0]]).max(axis=1) > _SAME]
        return Solved(self.x[kept], self.determinant[kept], self.residual[kept])


def solved_from(
    scene: Scene,
    seeds: Float[np.ndarray, "seeds 4"],
    clamp: Float[np.ndarray, "6"],
    inflections: int = 0,
) -> Solved:
    """Newton's method from each seed, a few steps at a time: those that have converged or gone
    astray are not carried on.
    """
    solver = _solver(inflections)
    x, determinant, residual = (
        seeds.copy(),
        np.full(len(seeds), np.nan),
        np.full(len(seeds), np.inf),
    )
    left = np.arange(len(seeds))
    for _ in range(_ROUNDS):
        if not left.size:
            break
        for first, last, blocks in runs(len(left), WIDE, scene.sizes):
            rows = left[first:last]
            used = -(-len(rows) // WIDE)
            found = from_blocks(
                np.asarray(solver(scene, to_blocks(x[rows], WIDE, blocks), clamp, used)), len(rows)
            )
            x[rows], determinant[rows], residual[rows] = found[:, :4], found[:, 4], found[:, 5]
        astray = ~np.isfinite(x[left]).all(axis=1) | (
            np.abs(x[left, :3] - clamp[:3]).max(axis=1) > _ASTRAY
        )
        left = left[~astray & ~(residual[left] < _SETTLED)]
    return Solved(x, determinant, residual)


def eased(
    scene: Scene,
    seeds: Float[np.ndarray, "seeds 4"],
    clamp: Float[np.ndarray, "6"],
    inflections: int = 0,
) -> Float[np.ndarray, "starts 4"]:
    """More starting points: the seeds, and for a rod of finite radius where they lead by way of
    thicker rods, which find round a sharp edge more easily.
    """
    if not isinstance(scene.surface, Offset):
        return seeds
    radius, x = scene.surface.radius, seeds
    doublings = max(0, int(np.log2(_THICKEST * scene.length / radius)))
    for doubling in range(doublings, 0, -1):
        thicker = scene._replace(surface=Offset(scene.surface.surface, radius * 2.0**doubling))
        # From all seeds at the thickest, then along from what they found.
        x = solved_from(thicker, x, clamp, inflections).distinct(clamp).x
        if not len(x):
            break
    return np.concatenate([x, seeds]) if doublings else seeds


@lru_cache(maxsize=8)
def _solver(inflections: int) -> Callable[[Scene, AnyArray, AnyArray, int], Array]:
    def step(scene: Scene, x: Array, clamp: Clamp) -> NewtonStep:
        return newton_step(scene, x, clamp, inflections)

    newton = jax.vmap(step, in_axes=(None, 1, None), out_axes=NewtonStep(1, 0, 0, 0))  # type: ignore[arg-type]

    @compiled
    def solve_blocks(
        scene: Scene,
        x: Float[AnyArray, "blocks 4 width"],
        clamp: Float[AnyArray, "6"],
        used: int | Int[Array, ""],
    ) -> Float[Array, "blocks 6 width"]:
        """A few steps for each of the first `used` blocks: states, determinants, residuals before
        the last step.
        """
        x, at = jnp.asarray(x), Clamp(jnp.asarray(clamp[:3]), jnp.asarray(clamp[3:]))
        width = x.shape[2]

        def iterate(_: Array | int, state: tuple[Array, Array]) -> tuple[Array, Array]:
            step = newton(scene, state[0], at)
            return step.x, jnp.stack([step.determinant, step.residual])

        def solve(index: Array, found: Array) -> Array:
            ended = lax.fori_loop(0, _STEPS, iterate, (x[index], jnp.zeros((2, width))))
            return found.at[index].set(jnp.concatenate(ended))

        solved: Array = lax.fori_loop(0, used, solve, jnp.zeros((x.shape[0], 6, width)))
        return solved

    return solve_blocks
