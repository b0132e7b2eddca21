"""Search for equilibria at one clamp pose from many starting points: for where the rod comes to
rest after a snap, for trails that begin in contact, and for tips caught between two parts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from vibrissa.contact import FRICTIONLESS, Held, Law, Scene, State
from vibrissa.forward.approach import free_rods, neutral
from vibrissa.forward.assess import (
    DEPTH_TOLERANCE,
    Assessment,
    assessed,
    assessment,
    deepest,
    levels,
)
from vibrissa.forward.march import from_seeds
from vibrissa.forward.path import chosen
from vibrissa.forward.solve import SHARP, solved
from vibrissa.geometry.rotation import lengths
from vibrissa.mechanics.model import Clamp
from vibrissa.numerics.lanes import AnyArray, lanes
from vibrissa.surfaces import Offset

_DIRECTIONS, _ENOUGH, _RAY_SAMPLES = (96, 384), 12, 48
"""Rays from the clamp, one in 16 degrees, or in 8 if fewer than so many meet the object; and points
on each: parts as thin as L/48 are seen.
"""
_SPARSE = 4
"""Times as many on the free rod, so that an edge which it barely grazes is seen; every fourth is a
starting point.
"""
_CONE = 1.25
"""1 − cos of the widest ray's angle to the rod: 105°, beyond which no bent rod reaches."""
_BESIDE = 0.04
"""Distance [L] of seeds to the sides of an expected contact, and of the points beside the clamp
that tell on which side of it the object is.
"""
_INWARD = 1e-4
"""Distance [L] past the place where the free rod enters the object."""
_SIDES, _EVERY = 8, 6
"""Directions tried out of the object, from every sixth point of the free rod inside it."""
FORCES = (0.05, 0.5, 1.5, 4.0)
"""Starting forces [EI/L²]: from a slight touch to beyond the buckling load π²/4."""
_ROUNDS = 2
"""Rounds of a dozen Newton steps each: where the rod may bend to any side, the Jacobian is singular
and convergence slow.
"""
_PORTIONS = 8
"""Parts of the starting points that are tried in turn."""
_SETTLED = 1e-9
"""Residual before the last Newton step; with quadratic convergence, more steps change nothing.
"""
_SAME = 1e-6
"""Difference in the unknowns up to which two equilibria count as one."""
_HEAD_ON = 1e-9
"""Share of a level up to which its change beside the clamp is rounding, and tells no direction."""
_THICKEST = 0.1
"""Radius [L] of the thickest rod used on the way round an edge."""
_REACH = 1.2
"""How far [L] from the clamp a contact may lie."""
_SHORTEST = 0.05
_CAUGHT = 0.15
"""How deep [L] a rod that touches twice may lie in the object at its second contact when solved for
the first alone.
"""
_ROUND_AN_EDGE = (0.05, 0.2, 0.4, 0.6, 0.8, 0.95)
"""Distances past the place where the rod enters, in fractions of a finite radius: the ways out from
there end on all sides of a rounded edge.
"""
_FINER = 33
_SECOND_PART = 0.2
"""How far [L] from a second part the seeds of a caught tip may lie."""
ENERGY_MARGIN = 1e-9
"""Energy [EI/L] that a snap loses at least, and by which different equilibria differ at least."""


@dataclass(frozen=True, eq=False)
class Settled:
    """One frictionless equilibrium: state, potential [EI/L], and whether the rod might just as
    well bend to any other side.
    """

    state: State
    values: Assessment
    determinant: float
    neutral: bool

    @property
    def energy(self) -> float:
        """Potential [EI/L]."""
        return float(self.values.potential)


class Solutions(NamedTuple):
    """Where Newton's method ended (k, …)."""

    state: State
    determinant: Float[AnyArray, "*k"]
    residual: Float[AnyArray, "*k"]
    """Before the last step."""


def lowest_equilibrium(scene: Scene, clamp: Clamp, near: State | None) -> Settled | None:
    """The admissible stable equilibrium of least energy found at a clamp pose; where none is
    admissible, the one that enters the object least.

    Among equal energies, as for a rod that may bend to any side, it is the one nearest to the first
    of the states `near` (k, …).

    Newton's method starts, with four magnitudes of the force, where rays from the clamp meet the
    object within the rod's length; where the free rod lies inside it, and a little to the side;
    around the contact of the first state `near`; and from each of those states.
    """
    seeds = seeds_around(scene, clamp, [] if near is None else [near.point[0]], FORCES)
    seeds = eased(scene, clamp, seeds if near is None else joined(seeds, near))
    # In closed form choosing takes longer than it saves.
    sparing = scene.rod.rough is not None
    found = solutions(scene, clamp, FRICTIONLESS, seeds, sparing=sparing)
    found = chosen(found, found.determinant < 0)
    count = len(found.residual)
    if not count:
        return None
    values, _ = assessed(scene, FRICTIONLESS, found.state, _repeated(clamp, count))
    sound = (values.residual < DEPTH_TOLERANCE) & (values.arc_length < 1 + DEPTH_TOLERANCE)
    good = sound & (values.depth < DEPTH_TOLERANCE)
    if not good.any():
        # A caught rod touches twice: take the single-contact equilibrium that comes nearest to
        # that; its assessment says so.
        caught = sound & (values.depth < _CAUGHT)
        good = caught & (values.depth == values.depth[caught].min(initial=np.inf))
    if not good.any():
        return None
    low = good & (values.potential < values.potential[good].min() + ENERGY_MARGIN)
    away = np.zeros(count) if near is None else lengths(found.state.point - near.point[0])
    row = int(np.argmin(np.where(low, away, np.inf)))
    alone = Clamp(*(part[None] for part in clamp))
    sideways = bool(neutral(scene, alone, values.direction[row][None])[0])
    state, at = chosen((found.state, values), row)
    return Settled(state, at, float(found.determinant[row]), sideways)


def caught(scene: Scene, clamps: Clamp) -> list[tuple[Assessment, Float[np.ndarray, "3"]] | None]:
    """Equilibria of least energy of rods that lie outside the object with their tips caught between
    two parts, at clamps (k, …); with the outward normals of the second parts.
    """
    return [_caught(scene, chosen(clamps, row)) for row in range(len(clamps.point))]


def _caught(scene: Scene, clamp: Clamp) -> tuple[Assessment, Float[np.ndarray, "3"]] | None:
    seeds = seeds_around(scene, clamp, [], FORCES)
    levels = np.asarray(_part_levels(scene.alone, seeds.point))
    pairs = np.sort(np.argsort(levels, axis=1)[:, :2], axis=1)
    near = np.sort(levels, axis=1)[:, 1] < _SECOND_PART
    best = None
    for pair in np.unique(pairs[near], axis=0):
        own = near & (pairs == pair).all(axis=1)
        starts = chosen(seeds, own)._replace(lean=np.full((int(own.sum()), 1), 0.5))
        held = partial(_held_by, scene, clamp, pair)
        state = _distinct(held, clamp, starts).state
        state = chosen(state, (state.lean[:, 0] > 0) & (state.lean[:, 0] < 1))
        _, values = held(state)
        law = Held(np.broadcast_to(pair, (len(state.force), 2)))
        depth = deepest(scene, state, _repeated(clamp, len(state.force)), law).depth
        values = chosen(values._replace(depth=depth), depth < DEPTH_TOLERANCE)
        for row in np.argsort(values.potential)[:1]:
            if best is None or values.potential[row] < best[0].potential:
                found = chosen(values, row)
                best = found, np.asarray(Held(pair).second_normal(scene, jnp.asarray(found.point)))
    return best


def _held_by(
    scene: Scene, clamp: Clamp, pair: Int[np.ndarray, "two"], seeds: State
) -> tuple[Solutions, Assessment]:
    """Where Newton's method leads from seeds (k, …) of tips held by two parts."""
    count = len(seeds.force)
    law = Held(np.broadcast_to(pair, (count, 2)))
    found: tuple[Solutions, Assessment] = _held(scene, seeds, _repeated(clamp, count), law)
    return found


@lanes(width=1, blocks=256)
def _held(scene: Scene, seed: State, clamp: Clamp, law: Held) -> tuple[Solutions, Assessment]:
    always = jnp.ones((), dtype=bool)
    found = solved(scene, law, seed, clamp, None, None, always, jnp.asarray(SHARP))
    state = found.reached.state
    solutions = Solutions(state, found.figure, found.residual)
    values, *_ = assessment(scene, state, clamp, law)
    return solutions, values


def _repeated(clamp: Clamp, count: int) -> Clamp:
    return Clamp(*(np.broadcast_to(part, (count, 3)) for part in clamp))


def seeds_around(
    scene: Scene, clamp: Clamp, near: list[Float[np.ndarray, "3"]], forces: tuple[float, ...]
) -> State:
    """Starting states (k, …) for Newton's method: where rays from the clamp enter the object, and
    around expected places, with several magnitudes of the force.
    """
    point, tangent, _ = clamp
    first, second = _sideways(scene, clamp)
    line, own_unknowns = chosen(free_rods(scene, Clamp(*(part[None] for part in clamp))), 0)
    meets, _ = rays_meet(scene, clamp)
    distance = np.arange(1, _SPARSE * _RAY_SAMPLES + 1) / (_SPARSE * _RAY_SAMPLES)
    along = _along(line, distance)
    own = levels(scene, along[None])[0]
    every = slice(_SPARSE - 1, None, _SPARSE)
    inside = along[every][own[every] < 0]
    expected = np.concatenate([np.reshape(near, (-1, 3)), inside])
    around = expected[:, None] + _BESIDE * np.stack([0 * first, first, -first, second, -second])
    # From where the free rod enters the object, and from inside it: the ways out sideways.
    step = np.flatnonzero((own[1:] < 0) & (own[:-1] >= 0))
    depths = [_INWARD]
    if isinstance(scene.surface, Offset):
        depths += [share * scene.surface.radius / scene.length for share in _ROUND_AN_EDGE]
    entered = _entered(scene, line, distance[step], distance[step + 1])
    entries = _along(line, (entered[:, None] + depths).ravel())
    turn = 2 * np.pi * np.arange(_SIDES) / _SIDES
    sideways = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    beside = _way_out(scene, np.concatenate([entries, inside[::_EVERY]]), sideways)
    points = np.concatenate([meets, around.reshape(-1, 3), beside])
    # Just after a first contact: the force that bends a cantilever sideways to there.
    to_there = beside - point
    reach = np.maximum(to_there @ tangent, _SHORTEST)
    aside = np.linalg.norm(to_there - (to_there @ tangent)[:, None] * tangent, axis=1)
    bending = np.minimum(3 * aside / reach**3, forces[-1])
    places = np.concatenate([np.tile(points, (len(forces), 1)), beside])
    stiffness = scene.rod.lateral_stiffness(np.linalg.norm(points - point, axis=1))
    bending *= stiffness[len(points) - len(beside) :]
    pushes = np.concatenate([np.outer(forces, stiffness).ravel(), bending])
    count = len(places)
    owned = np.broadcast_to(own_unknowns, (count, len(own_unknowns)))
    return State(places, pushes, np.zeros((count, 0)), owned)


def _sideways(scene: Scene, clamp: Clamp) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Two unit vectors across the rod at its clamp, the first away from the object: what is laid
    out about them turns with the scene, and not with the clamp about the rod.
    """
    axes = np.stack([clamp.across, np.cross(clamp.tangent, clamp.across)])
    around = levels(scene, clamp.point + _BESIDE * np.stack([axes, -axes], axis=1))
    slope = around[:, 0] - around[:, 1]
    if np.linalg.norm(slope) < _HEAD_ON * np.abs(around).max():
        slope = np.array([1.0, 0.0])
    first = slope @ axes / np.linalg.norm(slope)
    return first, np.cross(clamp.tangent, first)


def rays_meet(
    scene: Scene, clamp: Clamp
) -> tuple[Float[np.ndarray, "enters 3"], Float[np.ndarray, "leaves 3"]]:
    """Where rays from the clamp enter the object, and where they leave it, within the rod's
    length.
    """
    point, tangent, _ = clamp
    first, second = _sideways(scene, clamp)
    distance = np.arange(1, _RAY_SAMPLES + 1) / _RAY_SAMPLES

    def crossed(
        rays: Float[np.ndarray, "rays 3"], values: Float[np.ndarray, "rays samples"]
    ) -> Float[np.ndarray, "k 3"]:
        ray, sample = np.nonzero((values[:, 1:] < 0) & (values[:, :-1] >= 0))
        away = _crossing(values, ray, sample, distance)[:, None]
        return np.asarray(point + away * rays[ray])

    for count in _DIRECTIONS:
        # A golden spiral over one half of the directions within 105° of the tangent, and its mirror
        # image.
        order = np.arange(count // 2) + 0.5
        azimuth = np.pi * np.outer([1, -1], (1 + np.sqrt(5)) / 2 * order % 1).ravel()
        cosine = np.tile(1 - 2 * _CONE * order / count, 2)
        round_it = np.cos(azimuth)[:, None] * first + np.sin(azimuth)[:, None] * second
        rays = cosine[:, None] * tangent + np.sqrt(1 - cosine**2)[:, None] * round_it
        values = levels(scene, point + distance[None, :, None] * rays[:, None, :])
        enters, leaves = crossed(rays, values), crossed(rays, -values)
        if len(enters) >= _ENOUGH:
            break
    return enters, leaves


def _along(line: Float[np.ndarray, "n 3"], s: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k 3"]:
    """Points at arc lengths of a line given at equally spaced ones; straight beyond its end."""
    knots = np.linspace(0, 1, len(line))
    within = np.stack([np.interp(s, knots, column) for column in line.T], axis=-1)
    slope = (line[-1] - line[-2]) * (len(line) - 1)
    return within + np.maximum(s - 1, 0.0)[..., None] * slope


def _crossing(
    values: Float[np.ndarray, "rays samples"],
    ray: Int[np.ndarray, "k"],
    sample: Int[np.ndarray, "k"],
    distance: Float[np.ndarray, "samples"],
) -> Float[np.ndarray, "k"]:
    """Distances at which levels change sign after given samples, by linear interpolation."""
    before, after = values[ray, sample], values[ray, sample + 1]
    return np.asarray(distance[sample] + before / (before - after) * (distance[1] - distance[0]))


def _entered(
    scene: Scene,
    line: Float[np.ndarray, "n 3"],
    low: Float[np.ndarray, "k"],
    high: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "k"]:
    """Arc lengths at which the free rod enters the object, between one outside and one inside;
    accurate enough for an edge offset by a thin rod's radius.
    """
    share, rows = np.linspace(0, 1, _FINER), np.arange(len(low))
    for _ in range(2):
        samples = low[:, None] + (high - low)[:, None] * share
        inside = levels(scene, _along(line, samples)) < 0
        first = np.argmax(inside, axis=1)
        low, high = samples[rows, np.maximum(first, 1) - 1], samples[rows, np.maximum(first, 1)]
    return high


def _way_out(
    scene: Scene, bases: Float[np.ndarray, "bases 3"], sideways: Float[np.ndarray, "sides 3"]
) -> Float[np.ndarray, "k 3"]:
    """Where rays from points inside the object leave it, within half a rod length."""
    distance = np.arange(_RAY_SAMPLES // 2 + 1) / _RAY_SAMPLES
    starts, directions = np.repeat(bases, len(sideways), axis=0), np.tile(sideways, (len(bases), 1))
    values = levels(scene, starts[:, None] + distance[None, :, None] * directions[:, None])
    ray, sample = np.nonzero((values[:, :-1] < 0) & (values[:, 1:] >= 0))
    along = _crossing(values, ray, sample, distance)[:, None]
    return np.asarray(starts[ray] + along * directions[ray])


@lanes()
def _part_levels(scene: Scene, point: Float[Array, "3"]) -> Float[Array, "parts"]:
    return scene.part_levels(point)


def solutions(
    scene: Scene, clamp: Clamp, law: Law, seeds: State, *, sparing: bool = False
) -> Solutions:
    """Distinct converged contacts that push and lie near the clamp, from seeds (k, …): where a rod
    has a rougher one, that one's contacts from the seeds, and its own from those.

    Sparing, a quarter of the seeds are tried at first, half of them those that meet the conditions
    best, and then more until each stable contact has been found twice: hardly any are left to be
    found (I. J. Good, Biometrika 40 (1953) 237-264).
    """
    rough = scene.rod.rough
    if rough is None:
        return _solutions(scene, clamp, law, seeds, sparing=sparing)
    roughly = _solutions(scene._replace(rod=rough), clamp, law, seeds, sparing=sparing)
    return _solutions(scene, clamp, law, roughly.state)


def _solutions(
    scene: Scene, clamp: Clamp, law: Law, seeds: State, *, sparing: bool = False
) -> Solutions:
    def newton(seeds: State, tolerance: float = SHARP) -> tuple[Solutions, None]:
        steps = from_seeds(scene, law, clamp, seeds, tolerance)
        return Solutions(steps.reached.state, steps.figure, steps.residual), None

    if not sparing:
        return _distinct(newton, clamp, seeds)
    begun, _ = newton(seeds, np.finfo(float).max)
    order = np.argsort(begun.residual)
    best, others = np.split(order, [len(order) // _PORTIONS])
    first, *more = (others[portion::_PORTIONS] for portion in range(_PORTIONS))
    return _distinct(newton, clamp, begun.state, [np.concatenate([best, first]), *more])


def _distinct(
    newton: Callable[[State], tuple[Solutions, Any]],
    clamp: Clamp,
    seeds: State,
    portions: Sequence[Int[np.ndarray, "_"]] = (),
) -> Solutions:
    """The same for any Newton solver; portions of the seeds are tried in turn, in rounds."""
    tried = list[Solutions]()
    for portion, rounds in product(portions or [np.arange(len(seeds.force))], range(_ROUNDS)):
        if rounds == 0:
            untried = [np.full(len(portion), value) for value in (np.nan, np.inf)]
            tried.append(Solutions(chosen(seeds, portion), *untried))
        tried[-1] = _further(newton, tried[-1])
        found = jax.tree.map(lambda *parts: np.concatenate(parts), *tried)
        kept, times = _different(found, clamp)
        if portions and min(times, default=1) > 1:
            break
    single: Solutions = chosen(found, np.array(kept, dtype=int))
    return single


def _further(newton: Callable[[State], tuple[Solutions, Any]], found: Solutions) -> Solutions:
    """Where a round of Newton's method leads whatever has not converged."""
    left = np.flatnonzero(~(found.residual < _SETTLED))
    if not left.size:
        return found
    again, _ = newton(chosen(found.state, left))
    further: Solutions = jax.tree.map(partial(_put, left), found, again)
    return further


def different(states: State) -> Int[np.ndarray, "j"]:
    """Rows of states of which no two are the same."""
    rows, _ = _apart(states.flat_rows, np.arange(len(states.force)))
    return np.array(rows, dtype=int)


def _different(found: Solutions, clamp: Clamp) -> tuple[list[int], list[int]]:
    """Rows of solutions of which no two are the same, and how often each stable one was found."""
    near = np.linalg.norm(found.state.point - clamp.point, axis=1) < _REACH
    sound = (found.residual < _SETTLED) & (found.state.force > 0) & near
    kept, times = _apart(found.state.flat_rows, np.flatnonzero(sound))
    stable = found.determinant[kept] < 0
    return kept, [time for time, holds in zip(times, stable, strict=True) if holds]


def _apart(
    unknowns: Float[np.ndarray, "n unknowns"], rows: Int[np.ndarray, "j"]
) -> tuple[list[int], list[int]]:
    kept, times = list[int](), list[int]()
    while rows.size:
        other = np.abs(unknowns[rows] - unknowns[rows[0]]).max(axis=1) > _SAME
        kept.append(int(rows[0]))
        times.append(int(np.sum(~other)))
        rows = rows[other]
    return kept, times


def _joined(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.concatenate([first, second])


def _put(where: Int[np.ndarray, "j"], whole: np.ndarray, part: np.ndarray) -> np.ndarray:
    """The whole with some rows replaced."""
    replaced = whole.copy()
    replaced[where] = part
    return replaced


def eased(scene: Scene, clamp: Clamp, seeds: State, *, afresh: bool = False) -> State:
    """More starting points: the seeds and, for a rod of finite radius, where they lead via thicker
    rods, which find their way round a sharp edge more easily; afresh, from the seeds to each of
    them too.
    """
    if not isinstance(scene.surface, Offset):
        return seeds
    radius, starts = scene.surface.radius, seeds
    doublings = max(0, int(np.log2(_THICKEST * scene.length / radius)))
    for doubling in range(doublings, 0, -1):
        thicker = scene._replace(
            surface=type(scene.surface)(scene.surface.surface, radius * 2.0**doubling)
        )
        # From all seeds at the thickest, then on from what they found.
        starts = solutions(thicker, clamp, FRICTIONLESS, starts).state
        starts = joined(starts, seeds) if afresh else starts
    return joined(starts, seeds) if doublings and not afresh else starts


def joined(first: State, second: State) -> State:
    """States (j, …) and others (k, …) in one."""
    both: State = jax.tree.map(_joined, first, second)
    return both
