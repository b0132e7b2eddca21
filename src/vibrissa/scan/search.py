"""All equilibria that a search from many starting points finds at one clamp pose: for the rest after a snap, and for trails that begin in contact."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.numerics.blocks import in_blocks
from vibrissa.numerics.compiled import compiled
from vibrissa.scan.assess import DEPTH_TOLERANCE, assess_blocks, looked_at_closely
from vibrissa.scan.equations import Clamp, NewtonStep, Scene, level, newton_step
from vibrissa.surfaces import Offset

_DIRECTIONS = 96
_RAY_SAMPLES = 48
_BESIDE = 0.04
_INWARD = 1e-4
_SIDES = 8
_EVERY = 6
_FORCES = (0.05, 0.5, 1.5, 4.0)
_ITERATIONS = 40
_SAME = 1e-6
# Radius [L] of the thickest rod by whose way an edge is found, and how far [L] from the clamp a contact may lie on the way.
_THICKEST = 0.1
_REACH = 1.2


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One equilibrium: unknowns x = (p, f), bending energy [EI/L], sign of the Jacobian's determinant, and the phase difference."""

    x: Float[np.ndarray, "4"]
    energy: float
    determinant: float
    phase: float


def stable_equilibria(
    scene: Scene, point: Float[np.ndarray, "3"], tangent: Float[np.ndarray, "3"], near: list[Float[np.ndarray, "3"]]
) -> list[Equilibrium]:
    """Admissible stable equilibria found at a clamp pose, lowest energy first.

    Newton's method starts, with four magnitudes of the force, from the points where rays from the clamp meet the object within the rod's length; from where the
    straight rod lies in it, and a little beside that; and from points `near` which a contact is expected.
    """
    seeds = seeds_around(scene, point, tangent, near, _FORCES)
    if not len(seeds):
        return []
    clamps = np.broadcast_to(np.concatenate([point, tangent]), (len(seeds), 6))
    seeds = eased(scene, seeds, clamps)
    clamps = np.broadcast_to(clamps[0], (len(seeds), 6))
    solved = solved_from(scene, seeds, clamps)
    fields = in_blocks(lambda *parts: assess_blocks(scene, *parts), solved[:, :4], clamps)
    sound = (fields[:, 14] < DEPTH_TOLERANCE) & (solved[:, 3] > 0) & (solved[:, 4] < 0) & (fields[:, 7] < 1 + DEPTH_TOLERANCE)
    solved, fields = solved[sound], looked_at_closely(scene, solved[sound, :4], clamps[sound], fields[sound])[0]
    rows = np.concatenate([solved, fields], axis=1)[fields[:, 15] < DEPTH_TOLERANCE]
    x, determinant, energy, phase = rows[:, :4], rows[:, 4], rows[:, 5 + 11], rows[:, 5 + 13]
    found: list[Equilibrium] = []
    for row in np.argsort(energy):
        if all(np.abs(x[row] - other.x).max() > _SAME for other in found):
            found.append(Equilibrium(x[row], float(energy[row]), float(determinant[row]), float(phase[row])))
    return found


def seeds_around(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    tangent: Float[np.ndarray, "3"],
    near: list[Float[np.ndarray, "3"]],
    forces: tuple[float, ...],
) -> Float[np.ndarray, "seeds 4"]:
    """Starting points (p, f) for Newton's method: where rays from the clamp enter the object, and around expected places, with several magnitudes of the force."""
    # A Fibonacci spiral over the directions within 105° of the tangent.
    order = np.arange(_DIRECTIONS) + 0.5
    cosine = 1 - 1.25 * order / _DIRECTIONS
    azimuth = np.pi * (1 + np.sqrt(5)) * order
    first = np.cross(tangent, np.eye(3)[np.argmin(np.abs(tangent))])
    first /= np.linalg.norm(first)
    second = np.cross(tangent, first)
    sine = np.sqrt(1 - cosine**2)
    rays = cosine[:, None] * tangent + (sine * np.cos(azimuth))[:, None] * first + (sine * np.sin(azimuth))[:, None] * second
    distance = np.arange(1, _RAY_SAMPLES + 1) / _RAY_SAMPLES
    values = np.asarray(_levels(scene, point + distance[None, :, None] * rays[:, None, :]))
    enters = (values[:, 1:] < 0) & (values[:, :-1] >= 0)
    ray, sample = np.nonzero(enters)
    meets = _crossing(values, ray, sample, distance)
    along = point + distance[:, None] * tangent
    own = np.asarray(_levels(scene, along[None]))
    inside = along[own[0] < 0]
    expected = np.concatenate([np.reshape(near, (-1, 3)), inside])
    around = expected[:, None] + _BESIDE * np.stack([0 * first, first, -first, second, -second])
    # Where the straight rod enters the object, and where it lies in it: out of it sideways.
    step = np.flatnonzero((own[0, 1:] < 0) & (own[0, :-1] >= 0))
    entries = point + (_crossing(own, np.zeros_like(step), step, distance) + _INWARD)[:, None] * tangent
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    sideways = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    beside = _way_out(scene, np.concatenate([entries, inside[::_EVERY]]), sideways)
    points = np.concatenate([point + meets[:, None] * rays[ray], around.reshape(-1, 3), beside])
    return np.concatenate([np.column_stack([points, np.full(len(points), force)]) for force in forces])


def _crossing(
    values: Float[np.ndarray, "rays samples"],
    ray: Int[np.ndarray, "k"],
    sample: Int[np.ndarray, "k"],
    distance: Float[np.ndarray, "samples"],
) -> Float[np.ndarray, "k"]:
    """Distances at which levels change their sign behind given samples, by interpolation."""
    before, after = values[ray, sample], values[ray, sample + 1]
    return np.asarray(distance[sample] + before / (before - after) * (distance[1] - distance[0]))


def _way_out(scene: Scene, bases: Float[np.ndarray, "bases 3"], sideways: Float[np.ndarray, "sides 3"]) -> Float[np.ndarray, "k 3"]:
    """Where rays from points inside the object leave it, within half a rod length."""
    if not len(bases):
        return np.zeros((0, 3))
    distance = np.arange(_RAY_SAMPLES // 2 + 1) / _RAY_SAMPLES
    starts, directions = np.repeat(bases, len(sideways), axis=0), np.tile(sideways, (len(bases), 1))
    values = np.asarray(_levels(scene, starts[:, None] + distance[None, :, None] * directions[:, None]))
    ray, sample = np.nonzero((values[:, :-1] < 0) & (values[:, 1:] >= 0))
    return np.asarray(starts[ray] + _crossing(values, ray, sample, distance)[:, None] * directions[ray])


@jax.jit
def _levels(scene: Scene, points: Float[Array, "rays samples 3"]) -> Float[Array, "rays samples"]:
    return jax.vmap(jax.vmap(lambda point: level(scene, point)))(points)


def solved_from(
    scene: Scene, seeds: Float[np.ndarray, "seeds 4"], clamps: Float[np.ndarray, "seeds 6"], inflections: int = 0
) -> Float[np.ndarray, "seeds 5"]:
    """Where Newton's method ends from each seed, and the Jacobian's determinant there."""
    solver = _solver(inflections)
    return in_blocks(lambda *parts: solver(scene, *parts), seeds, clamps)


def eased(
    scene: Scene, seeds: Float[np.ndarray, "seeds 4"], clamps: Float[np.ndarray, "seeds 6"], inflections: int = 0
) -> Float[np.ndarray, "starts 4"]:
    """More starting points: the seeds, and for a rod of finite radius where they lead by way of thicker rods, which find round a sharp edge more easily."""
    if not isinstance(scene.surface, Offset):
        return seeds
    radius, x = scene.surface.radius, seeds
    doublings = max(0, int(np.log2(_THICKEST * scene.length / radius)))
    for doubling in range(doublings, 0, -1):
        thicker = scene._replace(surface=Offset(scene.surface.surface, radius * 2.0**doubling))
        solved = solved_from(thicker, x, clamps, inflections)[:, :4]
        sound = np.isfinite(solved).all(axis=1) & (solved[:, 3] > 0) & (np.abs(solved[:, :3] - clamps[:, :3]).max(axis=1) < _REACH)
        x = np.where(sound[:, None], solved, x)
    return np.concatenate([x, seeds])


@lru_cache(maxsize=8)
def _solver(inflections: int) -> Callable[[Scene, Array, Array], Array]:
    def step(scene: Scene, x: Array, clamp: Clamp) -> NewtonStep:
        return newton_step(scene, x, clamp, inflections)

    newton = jax.vmap(
        step,
        in_axes=(None, 1, 1),
        out_axes=NewtonStep(1, 0, 0, 0),  # type: ignore[arg-type]
    )

    @compiled
    def solve_blocks(
        scene: Scene, x: Float[Array, "blocks 4 width"], clamps: Float[Array, "blocks 6 width"]
    ) -> Float[Array, "blocks 5 width"]:
        def solve(block: tuple[Array, Array]) -> Array:
            x, clamp = block

            def iterate(_: Array | int, state: tuple[Array, Array]) -> tuple[Array, Array]:
                step = newton(scene, state[0], Clamp(clamp[:3], clamp[3:]))
                return step.x, step.determinant

            x, determinant = lax.fori_loop(0, _ITERATIONS, iterate, (x, jnp.zeros(x.shape[1])))
            return jnp.concatenate([x, determinant[None]])

        return lax.map(solve, (x, clamps))

    return solve_blocks
