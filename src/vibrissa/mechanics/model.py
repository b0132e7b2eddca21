"""The interface of rod models: what forward, inverse, calibration and design need from a rod.

A model is dimensionless: lengths in L, forces in EI/L², moments in EI/L (paper, eq. 1). It knows
nothing about the object.
"""

import math
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from vibrissa.geometry.rotation import rotation_matrices
from vibrissa.numerics.derivatives import exact

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]
Wrench = Float[Any, "6"]
Flag = Bool[Any, ""] | bool
Own = Float[Any, "own"] | tuple[()]


class Clamp(NamedTuple):
    """Clamp point [L] and axes: the rod leaves along z."""

    point: Vector
    tangent: Vector
    """Unit tangent of the rod: the clamp's z axis."""
    across: Vector
    """The clamp's x axis, from which a rod's rest shape and support are oriented."""

    @property
    def axes(self) -> tuple[Vector, Vector, Vector]:
        """Unit vectors along x, y and z."""
        return self.across, jnp.cross(self.tangent, self.across), self.tangent


def clamp_of(point: Float[np.ndarray, "*n 3"], orientation: Float[np.ndarray, "*n 4"]) -> Clamp:
    """Clamps (…, 3) at points [L] with orientations, unit quaternions x, y, z, w."""
    axes = rotation_matrices(orientation)
    return Clamp(point, axes[..., 2], axes[..., 0])


AT_ORIGIN = Clamp(np.zeros(3), np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
"""A clamp at the origin of axes that are its own."""


class Bent(NamedTuple):
    """A rod under one force at a point; the point lies on the rod where `misses` is zero."""

    point: Vector
    to_contact: Vector
    """r = P1 − P0 [L]."""
    force: Scalar
    direction: Vector
    """Unit vector of the force on the rod."""
    misses: Float[Any, "misses"]
    """How far [L] the rod passes from the point, in two directions, and one more for each of the
    model's own unknowns: zero in equilibrium.
    """
    arc_length: Scalar
    """Of the contact from the clamp [L]."""
    incidence: Scalar
    """(1 + t·d)/2 with t the tangent at the contact: ½ where the force is perpendicular to the rod.
    """
    inner: Any
    """What else the model knows about it."""
    load: Wrench | None = None
    """Resultants of distributed loads, the moment about the clamp."""

    @property
    def support_force(self) -> Vector:
        """Support force on the rod [EI/L²]."""
        force = -self.force * self.direction
        return force if self.load is None else force - self.load[:3]

    @property
    def base_moment(self) -> Vector:
        """Support moment on the rod [EI/L]: without loads r × F + m0 = 0, since one contact carries
        no couple.
        """
        moment = -self.force * jnp.cross(self.to_contact, self.direction)
        return moment if self.load is None else moment - self.load[3:]


class Contact(NamedTuple):
    """The contact that explains support reactions, seen from the clamp."""

    reach: Vector
    """r = P1 − P0 [L]."""
    direction: Vector
    """Unit vector of the contact force on the rod (paper, eq. 15)."""
    arc_length: Scalar
    incidence: Scalar
    """As in `Bent`; at least 1 where no contact explains the reactions."""
    energy: Scalar
    gap: Scalar
    """How far the rod passes there from the force's line of action [L]: zero for a contact."""
    load: Any = None
    """What distributed loads contribute to the reactions (6,), if there are any."""
    error: Any = 0.0
    """Estimate of what the division into steps does to the place [L], from above."""


class Free(eqx.Module):
    """A rod without contact."""

    @property
    def sound(self) -> Flag:
        """Whether it has such a shape, and a stable one."""
        return True

    @abstractmethod
    def at(self, s: Scalar) -> tuple[Vector, Vector, Vector | None]:
        """Point [L], unit tangent t and t' [1/L], None for zero, at an arc length."""

    @property
    def reactions(self) -> Wrench:
        """Support force and moment on the rod: none where nothing loads it."""
        return jnp.zeros(6)

    @property
    def energy(self) -> Scalar:
        """Energy of bending and twist [EI/L]."""
        return jnp.zeros(())


class Resting(NamedTuple):
    """What is known of a rod without contact once its shape has been found."""

    load: Own
    """Resultants of its loads, the moment about the clamp point."""
    sound: Flag
    """As in `Free`."""


class Straight(Free):
    """A straight rod that nothing loads."""

    clamp: Clamp

    def at(self, s: Scalar) -> tuple[Vector, Vector, None]:
        """As in `Free`."""
        point, tangent, _ = self.clamp
        return point + s * tangent, tangent, None


NEUTRAL = 1e-6
"""Sine of the angle between force and clamp axis up to which they count as parallel: above the
rounding of a face's coordinates in single precision, below any intended tilt.
"""


def is_neutral(direction: Vector, tangent: Vector) -> Bool[Array, ""]:
    """Whether a force acts along the clamp's axis, so that it fixes no bending plane."""
    return jnp.sum(jnp.cross(tangent, direction) ** 2) < NEUTRAL**2


class RodModel(eqx.Module):
    """How a clamped rod bends under one contact force."""

    accuracy: ClassVar[float] = 1e-9
    """Residual of the contact conditions up to which a state counts as solved."""
    last_step: ClassVar[float] = 1e-9
    """Residual from which one more Newton step, converging quadratically, leaves rounding."""
    linear: ClassVar[float] = math.inf
    """Standard deviation of an arc length [L] up to which a contact is linear in its wrench."""

    @property
    def unknowns(self) -> int:
        """How many unknowns of its own the model adds: none where the contact force alone
        determines the reactions, else the moment of other loads about the clamp point, and before
        it their force unless that is known.
        """
        return 0

    @abstractmethod
    def free(self, clamp: Clamp, resting: Resting | None = None) -> Free:
        """Return the rod without contact; what is known of it need not be found again."""

    @abstractmethod
    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        own: Own = (),
        reached: Vector | None = None,
        near: Scalar | None = None,
    ) -> Bent:
        """Return the rod under a force of given magnitude and direction at a point; `own` are
        unknowns of the model itself, `unknowns` in number.

        `reached` is r of a previous state: a force along the clamp's axis leaves the rod in the
        bending plane it had there; without it, in the plane of the point itself. `near` is an arc
        length next to which the contact lies, where one is known.
        """

    @abstractmethod
    def tangent(self, bent: Bent) -> Vector:
        """Unit tangent at the contact."""

    @abstractmethod
    def energy(self, bent: Bent) -> Scalar:
        """Bending energy [EI/L]."""

    def potential(self, bent: Bent) -> Scalar:
        """All energy that the clamp's work is stored as without friction [EI/L]: that of the
        support and of the loads too.
        """
        return self.energy(bent)

    @abstractmethod
    def largest_curvature(self, bent: Bent) -> Scalar:
        """Largest curvature along the rod [1/L]."""

    @abstractmethod
    def largest_bend(self, bent: Bent) -> Scalar:
        """Largest change of curvature by load [1/L], times the radius there over that at the
        clamp.
        """

    @property
    def loaded(self) -> bool:
        """Whether it exerts reactions without contact."""
        return False

    @property
    def alike_everywhere(self) -> bool:
        """Whether the rod without contact, seen from its clamp, depends on the clamp's orientation
        alone.
        """
        return True

    @property
    def uniform(self) -> bool:
        """Whether the radius is the same everywhere."""
        return True

    def slimmer(self, s: Scalar) -> Scalar:
        """Share of the clamp's radius by which the rod is thinner at an arc length."""
        return jnp.zeros_like(s)

    def lateral_stiffness(self, s: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Stiffness against a small force across the rod at arc lengths, over that of a uniform rod
        of the same stiffness at the clamp.
        """
        return np.ones_like(s)

    @property
    def rough(self) -> "RodModel | None":
        """Nearly the same rod at less cost, in arrays of the same shapes; its slopes will do for
        Newton's method. It is its own rougher one; None if only exact derivatives will do.
        """
        return None

    @property
    def derivatives(self) -> Callable[..., Any]:
        """How to differentiate what depends on the rod, as in `vibrissa.numerics.derivatives`."""
        return exact

    @property
    def finer(self) -> "RodModel":
        """The same rod, where it is divided into steps with half their length."""
        return self

    @abstractmethod
    def points(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """Points between contact (0) and clamp (1), at fixed fractions that space them about
        equally.
        """

    @abstractmethod
    def tail(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """Points between contact (0) and tip (1), at fractions of the arc length between them."""

    @abstractmethod
    def contact(
        self,
        force: Vector,
        moment: Vector,
        clamp: Clamp,
        which: Int[Any, ""] | int = 0,
    ) -> Contact:
        """Return the contact that explains support reactions: force and moment on the rod, the
        moment about the clamp. Of several, the first along the rod or a later one (`which`); with
        an arc length of NaN if there is none.
        """

    def contacts(self, force: Vector, moment: Vector, clamp: Clamp) -> Contact:
        """Return all `candidates` (k, …), in order along the rod."""
        alone: Contact = jax.tree.map(
            lambda part: jnp.asarray(part)[None], self.contact(force, moment, clamp)
        )
        return alone

    @property
    def candidates(self) -> int:
        """How many contacts there may be that explain the same reactions."""
        return 1
