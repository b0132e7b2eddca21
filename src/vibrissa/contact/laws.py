"""Contact laws: which way the object pushes, and what else must hold at the contact.

The contact force on the rod is F = f d. Without friction d is the object's normal n. With friction
d is along n + τ, where τ ⟂ n is the tangential force in units of the normal one, and Coulomb's law
ties τ to the step w of the rod's material point over the object (mechanics.md, "Friction"),

    τ = Π_μ(τ − c w),    Π_μ the projection onto the disk of radius μ in the tangent plane,

which means w = 0 inside the cone (sticking, or rolling where the contact also moves along the rod)
and τ = −μ w/|w| on it, without regularisation and for any c > 0 (Alart and Curnier, 1991). A tip
caught where two parts of an object meet is pushed by both: d ∝ (1 − σ) n_a + σ n_b, at a point that
lies on both.
"""

from abc import abstractmethod
from functools import partial
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array, lax
from jaxtyping import Float, Int

from vibrissa.contact.scene import Reached, Scene, State
from vibrissa.mechanics.model import Bent, Clamp
from vibrissa.numerics.vectors import dot

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]

_AUGMENTATION = 10.0
"""c of Coulomb's law [1/L]: any positive number gives the same solution; among 1 to 100 this one
took the fewest steps.
"""
_SOFTLY, _HARDLY = 0.1, 1e-6
"""Share of the force expected where a contact begins with which Newton's method starts, as the rod
is in contact for a part of the step only: too much leads astray, a twentieth to a fifth does as
well; and the least force [EI/L²].
"""
_TINY = 1e-300


class Push(NamedTuple):
    """How the object pushes at a point."""

    gaps: Float[Any, "gaps"]
    """First-order distances [L] of the point from the surfaces that it must lie on."""
    normal: Vector
    """Outward unit normal of the object."""
    direction: Vector
    """Unit vector of the contact force on the rod."""
    steepness: Scalar
    """‖∇g‖ at the contact."""


class Law(eqx.Module):
    """A law that the contact force obeys."""

    unknowns: ClassVar[int] = 0
    """How many unknowns the law adds to the point and magnitude of the force (`State.lean`)."""
    branch: ClassVar[bool] = True
    """Whether equilibria form a branch, without memory."""

    @abstractmethod
    def push(self, scene: Scene, state: State) -> Push:
        """How the object pushes."""

    def away(self, bent: Bent, tangent: Vector, normal: Vector) -> Scalar:  # noqa: ARG002
        """Half the sine of the angle by which the rod, continued past the contact, would enter the
        object: positive in tip contact, zero where the rod is tangent.
        """
        return 0.5 - bent.incidence

    def placed(self, left: Scalar, away: Scalar) -> Scalar:
        """Zero in tip contact (no rod is left beyond it) and where the rod is tangent to the
        object, so that no phase logic is needed.
        """
        return jnp.minimum(left, away)

    def rubs(
        self,
        scene: Scene,  # noqa: ARG002
        state: State,  # noqa: ARG002
        normal: Vector,  # noqa: ARG002
        bent: Bent,  # noqa: ARG002
        tangent: Vector,  # noqa: ARG002
        before: Reached | None,  # noqa: ARG002
    ) -> tuple[Float[Array, "rubs"], Scalar]:
        """Further conditions, and by how much the force would lie outside the cone if the contact
        were at rest.
        """
        return jnp.zeros(0), jnp.zeros(())

    def begun(
        self,
        scene: Scene,  # noqa: ARG002
        guess: State,
        before: Reached,  # noqa: ARG002
        begin: Clamp,  # noqa: ARG002
        clamp: Clamp,  # noqa: ARG002
    ) -> State:
        """Where Newton's method starts at a clamp pose: at the guess, unless a contact begins there
        and the law has to know which way the clamp came from `begin`.
        """
        return guess


def _normal(scene: Scene, point: Vector) -> tuple[Scalar, Vector, Scalar]:
    """First-order distance, outward normal and steepness."""
    value, gradient = jax.value_and_grad(scene.level)(point)
    steepness = jnp.sqrt(jnp.sum(gradient * gradient))
    return value / lax.stop_gradient(steepness), gradient / steepness, steepness


class Frictionless(Law):
    """The force is along the normal."""

    def push(self, scene: Scene, state: State) -> Push:
        """As in `Law`."""
        gap, n, steepness = _normal(scene, state.point)
        return Push(gap[None], n, n, steepness)


def _leaning(scene: Scene, point: Vector, lean: Vector) -> Push:
    gap, n, steepness = _normal(scene, point)
    along = n + lean
    return Push(gap[None], n, along / jnp.sqrt(jnp.sum(along * along)), steepness)


class Coulomb(Law):
    """Coulomb friction, quasi-static; `State.lean` is τ."""

    unknowns: ClassVar[int] = 3
    branch: ClassVar[bool] = False

    def push(self, scene: Scene, state: State) -> Push:
        """As in `Law`."""
        return _leaning(scene, state.point, state.lean)

    def away(self, bent: Bent, tangent: Vector, normal: Vector) -> Scalar:  # noqa: ARG002
        """As in `Law`."""
        return -dot(tangent, normal) / 2

    def rubs(
        self,
        scene: Scene,
        state: State,
        normal: Vector,
        bent: Bent,
        tangent: Vector,
        before: Reached | None,
    ) -> tuple[Float[Array, "rubs"], Scalar]:
        """Residual of τ − Π(τ − c w), and by how much the argument of the projection lies outside
        the disk; without a previous state, by how much τ does.
        """
        tau = state.lean
        lifted = dot(tau, normal) * normal
        if before is None:
            outside = jnp.maximum(jnp.sqrt(jnp.sum(tau * tau) + _TINY) - scene.friction, 0.0)
            return lifted + outside, outside
        # The step is implicit; its tangent is the mean of both ends.
        moved = state.point - before.state.point
        along = (tangent + before.tangent) / 2 * (bent.arc_length - before.arc_length)
        w = _AUGMENTATION * (moved - along)
        w = w - dot(w, normal) * normal
        trial = tau - lifted - w
        size = jnp.sqrt(jnp.sum(trial * trial) + _TINY)
        slides = tau - scene.friction / size * trial
        return jnp.where(size <= scene.friction, lifted + w, slides), size - scene.friction

    def begun(
        self, scene: Scene, guess: State, before: Reached, begin: Clamp, clamp: Clamp
    ) -> State:
        """As in `Law`: a contact without a force has no direction.

        If friction holds it, the force bends the rod back as far as the clamp carries it across its
        axis, 3 δ/s³ for a uniform one, and nowhere else; bent, the rod is shorter and slides along
        its axis, which takes what is left of the cone. If not, it slides across both its axis and
        the normal (mechanics.md, "Friction").
        """
        arm, along = guess.point - begin.point, before.tangent
        carried = clamp.point - begin.point - arm
        for old, new in zip(begin.axes, clamp.axes, strict=True):
            carried += dot(arm, old) * new
        back = dot(carried, along) * along - carried
        far = jnp.sqrt(dot(back, back)) + _TINY
        normal = self.push(scene, guess).normal
        beside = jnp.cross(along, back / far)
        off = dot(beside, normal)
        within = jnp.sqrt(jnp.maximum(1 - off**2, _TINY))
        beside = (beside - off * normal) / within
        inward = jnp.cross(normal, beside)
        inward *= jnp.sign(dot(inward, along))
        left = scene.friction**2 - (off / within) ** 2
        held = jnp.sqrt(jnp.maximum(left, 0.0)) * inward - off / within * beside
        aside = jnp.cross(along, normal)
        aside *= -jnp.sign(off * dot(aside, beside)) / jnp.sqrt(dot(aside, aside))
        lean = jnp.where(left > 0, held, scene.friction * aside)
        force = jnp.maximum(_SOFTLY * 3 * far / before.arc_length**3, _HARDLY)
        begun = guess._replace(force=force, lean=lean)
        return jax.tree.map(partial(jnp.where, guess.force == 0), begun, guess)


class Leaning(Law):
    """A given tangential force, in units of the normal one; only its part in the tangent plane
    counts.
    """

    lean: Vector

    def push(self, scene: Scene, state: State) -> Push:
        """As in `Law`."""
        _, n, _ = _normal(scene, state.point)
        return _leaning(scene, state.point, self.lean - dot(self.lean, n) * n)

    def away(self, bent: Bent, tangent: Vector, normal: Vector) -> Scalar:  # noqa: ARG002
        """As in `Law`."""
        return -dot(tangent, normal) / 2


class Held(Law):
    """A tip caught between two parts of the object; `State.lean` is the second part's share σ. Both
    act at one point, without a couple, so the reactions are those of a single contact.
    """

    unknowns: ClassVar[int] = 1
    pair: Int[Any, "*rows two"]

    def push(self, scene: Scene, state: State) -> Push:
        """As in `Law`, with the first part's normal."""
        levels, gradients = self._parts(scene, state.point)
        steepness = jnp.sqrt(jnp.sum(gradients**2, axis=1))
        normals = gradients / steepness[:, None]
        blend = (1 - state.lean[0]) * normals[0] + state.lean[0] * normals[1]
        return Push(levels, normals[0], blend / jnp.sqrt(jnp.sum(blend**2)), steepness[0])

    def placed(self, left: Scalar, away: Scalar) -> Scalar:  # noqa: ARG002
        """Zero where no rod is left beyond the contact."""
        return left

    def second_normal(self, scene: Scene, point: Vector) -> Vector:
        """Outward unit normal of the second part."""
        gradient = self._parts(scene, point)[1][1]
        return gradient / jnp.sqrt(jnp.sum(gradient**2))

    def _parts(
        self, scene: Scene, point: Vector
    ) -> tuple[Float[Array, "two"], Float[Array, "two 3"]]:
        return (
            scene.part_levels(point)[self.pair],
            jax.jacfwd(scene.part_levels)(point)[self.pair],
        )


FRICTIONLESS = Frictionless()
COULOMB = Coulomb()
