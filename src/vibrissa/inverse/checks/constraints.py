"""What over-determines a contact, and how each cause of error would show in it.

A straight uniform rod under a single contact force bends in a plane, so m·n̂ = 0 (a single force
carries no couple) and m·t = 0 (no torsion). It also obeys either s₁ = L (tip) or t·n̂ = 0
(tangential contact without friction: incidence ½). All are taken where the ideal rod's curvature
vanishes; that of the tip as g (L − s₁), with g = ‖t × n‖ the slope of the moment there, which is
linear in the noise through first contact. Any other rod without loads obeys them as well: there is
no moment at the contact of a single force.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import Bool, Float

from vibrissa.inverse.arrays import Flags
from vibrissa.inverse.kernels import explaining
from vibrissa.inverse.shared import STEEPEST
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.imperfect import Imperfect, contact_near, rod_end
from vibrissa.mechanics.model import AT_ORIGIN
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.lanes import AnyArray, lanes
from vibrissa.rod import Rod

COUPLE, TORSION, TIP, TANGENT = range(4)
"""Rows of the constraints."""
_AT_ONCE = 96
"""Stretches in one call, one after another: more than most sweeps have. Side by side they are
faster, but their code takes twice as long to compile.
"""
_OFF = 0.05
"""How far [L] from the tip, or from the line of the force, noise and a rod that is not quite as
described may put a contact.
"""


class Stated(NamedTuple):
    """A rod as it is described."""

    length: Any
    """In units of the stated one."""
    rod: Rod | None = None
    """None for a straight uniform one."""
    leaning: Any = np.inf
    """Largest cosine between force and rod before the tip."""


class Slopes(NamedTuple):
    """Of the constraints and the contact point, clamp axes and model units, with respect to what
    could be wrong.
    """

    constraints: Float[AnyArray, "*k 4 p"]
    point: Float[AnyArray, "*k 3 p"]


class Constraints(NamedTuple):
    """Values for the stretches in contact (k, …), and their derivatives."""

    value: Float[AnyArray, "*k 4"]
    """Of m·n̂, m·t, g (1 − s₁) and t·n̂."""
    reach: Float[AnyArray, "*k 3"]
    """Of the contact, clamp axes."""
    tangent: Float[AnyArray, "*k 3"]
    force: Float[AnyArray, "*k 3"]
    """On the rod."""
    arc_length: Float[AnyArray, "*k"]
    steepness: Float[AnyArray, "*k"]
    """g."""
    by_rod: Slopes
    """With respect to the numbers of `Imperfect` in turn, clamp axes: base wrench (6), fraction of
    the radius lost at the tip (1), rest curvature (2), load per length (3).
    """

    @property
    def by_wrench(self) -> Slopes:
        """With respect to the base wrench alone."""
        return Slopes(*(part[..., :6] for part in self.by_rod))


def holding(tip: Flags) -> Bool[np.ndarray, "n 4"]:
    """The three constraints that hold in each phase: where the tip touches, and where not."""
    both = np.ones_like(tip)
    return np.stack([both, both, tip, ~tip], axis=1)


@lanes(width=1, blocks=_AT_ONCE)
def constraints_of(stated: Stated, rod: Imperfect) -> Constraints:
    """Constraints for rods given by their base wrenches, clamp axes."""
    wrench, (length, described, leaning) = jnp.asarray(rod.wrench), stated
    model = Elastica() if described is None else spatial(described)
    found = model.contacts(wrench[:3], wrench[3:], AT_ORIGIN)
    which = jnp.argmax(explaining(found, STEEPEST, leaning, _OFF))
    ideal = found.arc_length[which]
    off_ideal = jnp.any(rod.load != 0) | jnp.any(rod.curvature != 0) | (rod.taper != 0)
    arc_length = jnp.where(off_ideal, contact_near(rod, ideal, described), ideal)

    here = rod_end(rod, arc_length, described)
    t, f = here.tangent, jnp.sqrt(jnp.sum(here.force**2))
    rate = -jnp.cross(t, here.force)
    g = jnp.sqrt(jnp.sum(rate**2))
    # Where the constraints hold the moment is zero: rotating its axes says nothing, and noise times
    # that rotation would look like a cause.
    axes = jnp.stack([here.force / f, t, rate / g])
    flat, unravel = ravel_pytree(rod)

    def seen(numbers: Array) -> Any:
        end = rod_end(unravel(numbers), arc_length, described)
        couple, torsion, off = axes @ end.moment
        square = end.tangent @ end.force / jnp.sqrt(jnp.sum(end.force**2))
        value = jnp.stack([couple, torsion, g * (length - arc_length) + off, square])
        both = value, end.reach - t * off / g
        return both, (*both, arc_length - off / g)

    slopes, (value, reach, place) = jax.jacfwd(seen, has_aux=True)(flat)
    return Constraints(value, reach, t, here.force, place, g, Slopes(*slopes))
