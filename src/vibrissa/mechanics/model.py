"""The interface of rod models: what forward, inverse, calibration and design need from a rod.

A model is dimensionless: lengths in L, forces in EI/L², moments in EI/L (paper, eq. 1). It knows
nothing about the object.
"""

from abc import abstractmethod
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float

Scalar = Float[Any, ""]
Vector = Float[Any, "3"]


class Clamp(NamedTuple):
    """Clamp point [L] and unit tangent of the rod there."""

    point: Vector
    tangent: Vector


class Bent(NamedTuple):
    """A rod under one force at a point; the point lies on the rod where `misses` is zero."""

    point: Vector
    to_contact: Vector
    """r = P1 − P0 [L]."""
    force: Scalar
    direction: Vector
    """Unit vector of the force on the rod."""
    misses: Float[Any, "two"]
    """How far [L] the point lies out of the rod's plane, and how far the rod is from it along the
    force.
    """
    arc_length: Scalar
    """Of the contact from the clamp [L]."""
    incidence: Scalar
    """(1 + t·d)/2 with t the tangent at the contact: ½ where the force is perpendicular to the rod.
    """
    inner: Any
    """What else the model knows about it."""

    @property
    def base_moment(self) -> Vector:
        """Support moment on the rod: r × F + m0 = 0, since one contact carries no couple."""
        return -self.force * jnp.cross(self.to_contact, self.direction)


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


NEUTRAL = 1e-6
"""Sine of the angle between force and clamp axis up to which they count as parallel: above the
rounding of a face's coordinates in single precision, below any intended tilt.
"""


def is_neutral(direction: Vector, tangent: Vector) -> Bool[Array, ""]:
    """Whether a force acts along the clamp's axis, so that it fixes no bending plane."""
    return jnp.sum(jnp.cross(tangent, direction) ** 2) < NEUTRAL**2


class RodModel(eqx.Module):
    """How a clamped rod bends under one contact force."""

    @abstractmethod
    def bent(
        self,
        clamp: Clamp,
        point: Vector,
        force: Scalar,
        direction: Vector,
        reached: Vector | None = None,
    ) -> Bent:
        """Return the rod under a force of given magnitude and direction at a point.

        `reached` is r of a previous state: a force along the clamp's axis leaves the rod in the
        bending plane it had there; without it, in the plane of the point itself.
        """

    @abstractmethod
    def tangent(self, bent: Bent) -> Vector:
        """Unit tangent at the contact."""

    @abstractmethod
    def energy(self, bent: Bent) -> Scalar:
        """Bending energy [EI/L]."""

    @abstractmethod
    def largest_curvature(self, bent: Bent) -> Scalar:
        """Largest curvature along the rod [1/L]."""

    @abstractmethod
    def points(self, bent: Bent, share: Float[np.ndarray, "n"]) -> Float[Array, "n 3"]:
        """Points between contact (0) and clamp (1), at fixed fractions that space them about
        equally.
        """

    @abstractmethod
    def contact(self, force: Vector, moment: Vector, tangent: Vector) -> Contact:
        """Return the contact that explains support reactions (on the rod, moment about the clamp)
        of a rod whose unit tangent at the clamp is given.
        """
