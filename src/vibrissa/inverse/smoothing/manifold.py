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
"""

from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Bool, Float

from vibrissa.mechanics.elastica import BasePlane, ContactOnRod, contact_on_rod
from vibrissa.numerics.lanes import lanes

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


class Bent(NamedTuple):
    """What the coordinates imply; or its derivatives, with the coordinates as last axis."""

    wrench: Float[Any, "*n wrench"]
    """Support reactions (f0, m0)."""
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


def linear_at(x: Float[Array, "coordinates"]) -> Linear:
    """The manifold linearised about one sample's coordinates."""
    slope, value = jax.jacfwd(lambda x: (bent(x),) * 2, has_aux=True)(x)
    return Linear(x, value, slope)


_LINEAR = lanes()(lambda _, x: linear_at(x))


def linearised(x: Float[np.ndarray, "n coordinates"]) -> Linear:
    """The manifold linearised about the coordinates of many samples."""
    loaded = np.any(x != AT_REST, axis=1)
    # Rods at rest are all alike: the first row stands for them.
    found: Linear = _LINEAR(None, np.concatenate([[AT_REST], x[loaded]]))
    return jax.tree.map(lambda part: part[loaded * np.cumsum(loaded)], found)


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
