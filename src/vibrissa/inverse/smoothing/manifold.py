"""The manifold of single-contact wrenches, in coordinates that vary smoothly along a sweep. Clamp
axes, model units.

The torsional moment of a straight rod is constant and zero at its free end, so m0 is perpendicular
to t0 as well as to the force (mechanics.md, "The elastic line is plane"). In clamp axes, t0 = e_z,
a single contact then leaves four numbers: the moment (m_x, m_y), the axial force F_z and the arc
length s₁, with

    F_⊥ = γ t0 × m0,

where γ is such that the curvature first vanishes at s₁. On a straight rod without axial force
γ = 1/s₁, and 1/s₁ rises with γ throughout. The coordinates are regular through first contact
(m0 = 0), and where the force passes behind the clamp's axis (γ = 0).

A rod that is not quite straight, or a clamp that is not quite true, tilts m0 slightly out of the
plane perpendicular to t0. The fifth coordinate is that tilt ε:

    m0 = (m_x, m_y, ε m),    F = γ t0 × m0 + F_z (t0 − ε m̂),    m = ‖(m_x, m_y)‖,

which keeps m0·F = 0, as in any single contact.

The same coordinates describe the contacts of any other rod: of its reactions m_x, m_y and F_z are
given, and the other three are those that leave no moment in it at s₁. Loads add their resultants
to the unknowns, and what they leave at the tip to the equations; the coordinates are then those of
the reactions in excess of the free rod's, which are zero without contact. The tilt turns the whole
rod about m̂ × t0.
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float

from vibrissa.mechanics import model
from vibrissa.mechanics.elastica import BasePlane, ContactOnRod, contact_on_rod
from vibrissa.mechanics.free import check_stands, free_rods
from vibrissa.mechanics.kirchhoff import Inner, Kirchhoff, Push
from vibrissa.mechanics.model import AT_ORIGIN, Clamp, RodModel
from vibrissa.mechanics.models import model_of
from vibrissa.numerics.derivatives import CHANGE, by_differences, implicit
from vibrissa.numerics.lanes import AnyArray, lanes
from vibrissa.numerics.linear import solve_pivoted
from vibrissa.numerics.rotation import first_axis, rotation_matrix, third_axis, turned
from vibrissa.numerics.vectors import dot, joined
from vibrissa.rod import Rod
from vibrissa.trail import Trail

Scalar = Float[Array, ""]
Tree = TypeVar("Tree")

COORDINATES = 5
"""m_x, m_y, F_z, s₁, ε."""
LOADS = ARC_LENGTH = 3
"""Moment and axial force come first, then the arc length."""
TILT = 4
AT_REST = np.array([0.0, 0.0, 0.0, 1.0, 0.0])
"""Coordinates of a rod that touches nothing, as when it meets an object with its tip."""
_NEWTON_STEPS = 6
"""Enough to reach rounding from the start below if s₁ > 0.02; one more carries the derivatives."""
_LEAST_MOMENT = 1e-6
"""Added in squares, so that directions are differentiable without load: far below any noise."""
_MOST_STEPS, _SETTLED = 16, 1e-6
"""Most evaluations on the way to the reactions of any other rod, where six usually suffice, and the
last Newton step [EI/L²]: the next would be its square.
"""


_RESOLUTION = 6
"""Steps along any other rod: 1e-6 in wrench and point on strongly bent tapered rods."""
_LEAST_AHEAD = 0.2
"""How far the tip must be ahead of the clamp [L], for the moment to tell the lateral force."""


class Pose(NamedTuple):
    """Where a loaded rod's clamp is, as loads are given in world axes, and what it exerts there
    without contact; one row per sample.
    """

    position: Float[Any, "*n 3"]
    """Of the clamp [L]."""
    orientation: Float[Any, "*n 4"]
    free: Float[Any, "*n wrench"]
    """Reactions without contact, clamp axes."""


class Bent(NamedTuple):
    """What the coordinates imply; or its derivatives, with the coordinates as last axis."""

    wrench: Float[Any, "*n wrench"]
    """Support reactions (f0, m0), in excess of those without contact."""
    incidence: Float[Any, "*n"]
    """(1 + t·d)/2 with t the rod's tangent at the contact and d the force's direction: k² of a
    uniform straight rod.
    """
    reach: Float[Any, "*n 3"]
    """Contact point relative to the clamp."""
    direction: Float[Any, "*n 3"]
    """Unit vector of the contact force on the rod."""
    energy: Float[Any, "*n"]


class Linear(NamedTuple):
    """The manifold linearised about coordinates, one row per sample; not finite where no rod has
    them: without a zero of the curvature (k² ≥ 1) there is no contact.
    """

    x: Float[Any, "*n coordinates"]
    value: Bent
    slope: Bent
    """Derivatives with respect to the coordinates."""


def linear_at(
    x: Float[Array, "coordinates"], rod: RodModel | None = None, pose: Pose | None = None
) -> Linear:
    """The manifold linearised about one sample's coordinates; by default that of a uniform straight
    rod.
    """
    if isinstance(rod, Kirchhoff):
        return _spatial_at(x, rod, pose)
    slope, value = jax.jacfwd(lambda x: (bent(x),) * 2, has_aux=True)(x)
    return Linear(x, value, slope)


_LINEAR = lanes(walks=True)(lambda rod, pose, x: linear_at(x, rod, pose))


def linearised(rod: RodModel, pose: Pose | None, x: Float[np.ndarray, "n coordinates"]) -> Linear:
    """The manifold linearised about the coordinates of many samples."""
    loaded = np.any(x != AT_REST, axis=1)
    # Rods at rest are all alike: the first row stands for them.
    some = np.append(0, np.flatnonzero(loaded))
    rows = np.where(loaded, np.cumsum(loaded), 0)
    poses = jax.tree.map(lambda part: part[some], pose)
    found: Linear = _LINEAR(rod, poses, np.concatenate([[AT_REST], x[loaded]]))
    return jax.tree.map(lambda part: part[rows], found)


def smoothed_model(rod: Rod) -> RodModel:
    """How a rod bends, as precisely as the noise of sensors asks for.

    Raises
    ------
    ValueError
        If the unloaded rod does not lead away from the clamp; with loads, `poses_of` says so.
    """
    found = model_of(rod, _RESOLUTION)
    if rod.rest is not None and rod.loads is None:
        _check_ahead(free_rods(found, np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]])).ahead)
    return found


def poses_of(rod: RodModel, trail: Trail, length: float) -> Pose | None:
    """Poses of one trail (n, …), if the rod is loaded.

    Raises
    ------
    ValueError
        If a load bends the rod back to the clamp.
    """
    if not rod.loaded:
        return None
    position = trail.position / length
    free = free_rods(rod, position, trail.orientation)
    _check_ahead(free.ahead)
    parts = free.reactions.reshape(-1, 2, 3) @ trail.rotation
    return Pose(position, trail.orientation, parts.reshape(-1, 6))


def _check_ahead(ahead: AnyArray) -> None:
    check_stands(ahead)
    least = float(np.min(ahead))
    if not least > _LEAST_AHEAD:
        raise ValueError(
            f"without contact the rod's tip is {least:.3g} rod lengths ahead of the clamp; "
            f"smoothing needs more than {_LEAST_AHEAD}"
        )


def finite(rows: Any) -> Bool[np.ndarray, "n"]:
    """Rows of a tree of arrays that hold only finite numbers."""
    parts = (np.isfinite(part).reshape(len(part), -1) for part in jax.tree.leaves(rows))
    return np.all([part.all(axis=1) for part in parts], axis=0)


def chosen(rows: Bool[np.ndarray, "n"], first: Tree, second: Tree | float) -> Tree:
    """The first tree of arrays in these rows; elsewhere the second, or a number."""
    return jax.tree.map(
        lambda one, other: np.where(rows, one.T, np.transpose(other)).T,
        first,
        jax.tree.broadcast(second, first),
    )


def bent(x: Float[Array, "coordinates"]) -> Bent:
    """Reactions and contact of the rod with these coordinates."""
    moment, axial, arc_length, tilt = x[:2], x[2], x[ARC_LENGTH], x[TILT]
    size = jnp.sqrt(jnp.sum(moment**2) + _LEAST_MOMENT**2)
    gamma = lateral_ratio(size, axial, arc_length)
    rod = _section(size, axial, gamma)
    along_moment = -tilt * axial * moment / size
    force = jnp.stack(
        [along_moment[0] - gamma * moment[1], along_moment[1] + gamma * moment[0], axial]
    )
    m0 = jnp.stack([moment[0], moment[1], tilt * size])
    f = jnp.sqrt(jnp.sum(force**2) + _LEAST_MOMENT**2)
    n = force / f
    reach = jnp.cross(m0, n) / f - rod.advance * n
    energy = f * (rod.advance - (1 - 2 * rod.modulus) * rod.arc_length)
    return Bent(jnp.concatenate([-force, m0]), rod.modulus, reach, n, energy)


def lateral_ratio(moment: Scalar, axial: Scalar, arc_length: Scalar) -> Scalar:
    """γ for which the curvature vanishes at a given arc length: Newton's method on 1/s₁, which is
    nearly linear in γ. Differentiable.
    """
    fixed = lax.stop_gradient((moment, axial, arc_length))

    def excess(gamma: Scalar) -> Scalar:
        return _excess(gamma, *fixed)

    def step(_: Array | int, state: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        gamma, sound = state
        value, slope = jax.jvp(excess, (gamma,), (jnp.ones_like(gamma),))
        good = jnp.isfinite(value) & (slope > 0)
        return jnp.where(good, gamma - value / slope, (gamma + sound) / 2), jnp.where(
            good, gamma, sound
        )

    # Under tension a straight rod has γ s₁ = √z coth √z ≤ 1 + z/3 with z = F_z s₁².
    start = (1 + jnp.maximum(fixed[1] * fixed[2] ** 2, 0.0) / 3) / fixed[2]
    root = lax.stop_gradient(lax.fori_loop(0, _NEWTON_STEPS, step, (start, start))[0])
    _, slope = jax.jvp(excess, (root,), (jnp.ones_like(root),))
    # One more step, which carries the derivatives of the arguments (implicit function theorem).
    return root - _excess(root, moment, axial, arc_length) / slope


def _excess(gamma: Scalar, moment: Scalar, axial: Scalar, arc_length: Scalar) -> Scalar:
    return 1 / _section(moment, axial, gamma).arc_length - 1 / arc_length


def _section(moment: Scalar, axial: Scalar, gamma: Scalar) -> ContactOnRod:
    lateral = gamma * moment
    f = jnp.sqrt(axial**2 + lateral**2)
    cosine, sine = axial / f, lateral / f
    # 1 − cos δ = 2 cos² a₀, without cancellation where the force points along the rod.
    toward = jnp.where(cosine > 0, sine**2 / (1 + jnp.abs(cosine)), 1 - cosine)
    return contact_on_rod(BasePlane(sine / jnp.sqrt(2 * toward), moment / f), f)


class _Sought(NamedTuple):
    """Unknowns of a rod with given coordinates on the way to where they leave nothing."""

    unknowns: Float[Array, "unknowns"]
    change: Scalar
    """Of the last step."""
    steps: Array
    done: Bool[Array, ""]
    slopes: tuple[Float[Array, "unknowns unknowns+coordinates"], Bent]
    """Derivatives of what is left, and of the rod, with respect to the unknowns and, in the end,
    the coordinates.
    """
    values: tuple[Float[Array, "unknowns"], Bent]


def _spatial_at(x: Float[Array, "coordinates"], rod: Kirchhoff, pose: Pose | None) -> Linear:
    """The manifold of any rod, linearised: Newton's method and the implicit function theorem."""

    def at(unknowns: Array, count: Any) -> tuple[tuple[Array, Bent], tuple[Array, Bent]]:
        def left(both: Array) -> tuple[tuple[Array, Bent], tuple[()]]:
            return _of_reactions(both[:-COORDINATES], both[-COORDINATES:], rod, pose), ()

        # Backwards: a contact at the tip is compared with those before it.
        slopes, (values, _) = by_differences(left, joined(unknowns, x), change=-CHANGE, count=count)
        return slopes, values

    def refined(last: _Sought) -> _Sought:
        settled = last.change <= _SETTLED
        slopes, values = at(last.unknowns, len(last.unknowns) + COORDINATES * settled)
        step, _ = solve_pivoted(slopes[0][:, :-COORDINATES], values[0])
        step = jnp.where(settled, 0.0, step)
        change = jnp.max(jnp.abs(step))
        return _Sought(last.unknowns - step, change, last.steps + 1, settled, slopes, values)

    def unfinished(last: _Sought) -> Bool[Array, ""]:
        return ~last.done & ~jnp.isnan(last.change) & (last.steps < _MOST_STEPS)

    # Without axial force, on a straight rod.
    start = joined(-x[1] / x[ARC_LENGTH], x[0] / x[ARC_LENGTH], jnp.zeros(1 + rod.unknowns))
    blank = jax.tree.map(lambda part: jnp.full(part.shape, jnp.nan), jax.eval_shape(at, start, 0))
    none = jnp.zeros((), dtype=int)
    first = _Sought(start, jnp.asarray(jnp.inf), none, none > 0, *blank)
    found = lax.while_loop(unfinished, refined, first)
    (of_left, slope), (_, value) = jax.tree.map(
        lambda part: jnp.where(found.done, part, jnp.nan), (found.slopes, found.values)
    )
    by_unknowns, by_x = of_left[:, :-COORDINATES], of_left[:, -COORDINATES:]
    moved = implicit(by_unknowns, by_x)
    slope = jax.tree.map(
        lambda part: part[..., :-COORDINATES] @ moved + part[..., -COORDINATES:], slope
    )

    def tilted(at: Array) -> tuple[Bent, Bent]:
        near = jax.tree.map(lambda value, slope: value + slope @ (at - x), value, slope)
        axis = jnp.stack([at[1], -at[0], 0 * at[0]]) / jnp.sqrt(
            dot(at[:2], at[:2]) + _LEAST_MOMENT**2
        )
        force, moment, reach, direction = (
            turned(at[TILT] * axis, part)
            for part in (near.wrench[:3], near.wrench[3:], near.reach, near.direction)
        )
        whole = near._replace(wrench=joined(force, moment), reach=reach, direction=direction)
        return whole, whole

    slope, value = jax.jacfwd(tilted, has_aux=True)(x)
    return Linear(x, value, slope)


def _of_reactions(
    unknowns: Float[Array, "unknowns"], x: Float[Array, "coordinates"], rod: Kirchhoff, pose: Any
) -> tuple[Float[Array, "unknowns"], Bent]:
    """What a rod's equations leave, and the rod. Unknown are the lateral force and the torsion in
    its reactions, and the excess of the loads' resultants over the free rod's.
    """
    wrench = joined(-unknowns[:2], -x[2], x[:2], unknowns[2])
    clamp, turn, load = AT_ORIGIN, jnp.eye(3), None
    excess: Any = 0.0
    if pose is not None:
        at = pose.orientation
        clamp, turn = Clamp(pose.position, third_axis(at), first_axis(at)), rotation_matrix(at)
        excess = joined(jnp.zeros(6 - rod.unknowns), unknowns[3:])
        load = excess - _turned(turn, pose.free)
    push = -_turned(turn, wrench) - excess
    force, s1 = push[:3], x[ARC_LENGTH]
    inner = Inner(rod.line(clamp, Push(force, push[3:]), load), clamp, Push(force, push[3:]))
    reach, tangent = inner.line.at(s1)
    left = push[3:] - jnp.cross(reach, force)
    f = jnp.sqrt(dot(force, force) + _LEAST_MOMENT**2)
    n = force / f
    incidence = (1 + dot(tangent, n)) / 2
    if rod.loaded:
        rest = rod.beyond(inner, s1).states
        left, energy = joined(left, rest.load[-1, 6 - rod.unknowns :]), rest.energy[-1]
    else:
        energy = rod.energy(model.Bent(reach, reach, f, n, left, s1, incidence, inner))
    seen, direction = (jnp.sum(turn.T * part, axis=1) for part in (reach, n))
    return left, Bent(wrench, incidence, seen, direction, energy)


def _turned(matrix: Float[Array, "3 3"], wrench: Float[Array, "6"]) -> Float[Array, "6"]:
    return joined(*(jnp.sum(matrix * part, axis=1) for part in (wrench[:3], wrench[3:])))
