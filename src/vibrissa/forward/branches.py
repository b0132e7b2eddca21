"""Equilibria of any rod by way of those of a straight, uniform one, which has a closed form.

Far from an equilibrium under a large force, Newton's method on an integrated rod hardly ever finds
it: errors grow along the rod as the exponential of the force's square root. In closed form it does,
and the branch of each equilibrium leads on as the rod gradually becomes another.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import chain
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.contact import FRICTIONLESS, Scene, State
from vibrissa.forward.search import eased, joined, rays_meet, seeds_around, solutions
from vibrissa.mechanics.elastica import Elastica, base_plane
from vibrissa.mechanics.kirchhoff import Kirchhoff
from vibrissa.mechanics.model import Clamp
from vibrissa.numerics.compiled import compiled
from vibrissa.numerics.derivatives import by_differences
from vibrissa.numerics.lanes import lanes
from vibrissa.numerics.vectors import dot

FORCES = ((0.05, 0.5, 1.5, 4.0, 8.0), (12.0, 20.0, 30.0, 45.0), (50.0, 75.0, 110.0))
"""Starting magnitudes of the force [EI/L²] for Newton's method, by number of inflections: about
(2K/s₁)² and more.
"""
_SHARES = (0.3, 0.6, 0.9, 1.0)
"""The same as shares of the force at which the rod is tangent to the object."""
_STRIDE, _LEAST_STRIDE = 1 / 16, 1 / 256
"""Share of the way from one rod to the other gone at once, and the share at which a branch is taken
to end if no equilibrium was found on it.
"""


class _Plain(Elastica):
    """Where the rod may turn about the clamp's axis, exact slopes are singular, and a step leads
    anywhere; the errors of differences are larger than the residual's rounding, and hold it.
    """

    @property
    def derivatives(self) -> Callable[..., Any]:
        """As in `RodModel`."""
        return by_differences


def in_closed_form(scene: Scene, clamp: Clamp, inflections: int) -> tuple[Scene, State]:
    """Contacts (k, …) of a straight, uniform rod whose curvature changes sign so many times."""
    scene = scene._replace(rod=_Plain(inflections))
    around = seeds_around(scene, clamp, [], FORCES[inflections])
    seeds = joined(around, _tangential_seeds(scene, clamp))
    seeds = eased(scene, clamp, seeds, afresh=True)
    return scene, solutions(scene, clamp, FRICTIONLESS, seeds).state


def contacts_of(rod: Kirchhoff, scene: Scene, clamp: Clamp, starts: State) -> tuple[Scene, State]:
    """Contacts (k, …) of any rod: those to which others of a straight, uniform rod lead, and those
    that Newton's method finds from many starting points on the rougher rod.
    """
    # Without rougher ones for their slopes: far from a contact, the rods' own lead to more of them.
    fine = _partly(rod, 1.0)
    assert rod.roughly is not None
    scene, rough = (scene._replace(rod=replace(fine, steps=s)) for s in (rod.steps, rod.roughly))
    seeds = seeds_around(rough, clamp, [], tuple(chain(*FORCES)))
    seeds = eased(rough, clamp, seeds, afresh=True)
    state = starts._replace(own=np.zeros((len(starts.force), rod.unknowns)))
    share, stride = 0.0, _STRIDE
    while share < 1 and len(state.force):
        ahead = min(share + stride, 1.0)
        between = scene._replace(rod=_partly(rod, ahead))
        found = solutions(between, clamp, FRICTIONLESS, state).state
        if len(found.force) < len(state.force) and stride > _LEAST_STRIDE:
            stride /= 2
        else:
            state, share, stride = found, ahead, _STRIDE
    state = joined(state, solutions(rough, clamp, FRICTIONLESS, seeds).state)
    return scene, solutions(scene, clamp, FRICTIONLESS, state).state


_partly = compiled(Kirchhoff.partly, quick=True)


def _tangential_seeds(scene: Scene, clamp: Clamp) -> State:
    """Starting states (k, …) where rays from the clamp enter and leave the object."""
    points = np.concatenate(rays_meet(scene, clamp))
    most = np.asarray(_tangential_force((scene, clamp), points))
    points, most = points[most > 0], most[most > 0]
    forces, count = np.outer(_SHARES, most).ravel(), len(_SHARES) * len(most)
    return State(np.tile(points, (len(_SHARES), 1)), forces, *np.zeros((2, count, 0)))


@lanes()
def _tangential_force(shared: tuple[Scene, Clamp], point: Float[Array, "3"]) -> Float[Array, ""]:
    """Force at which a straight, uniform rod in contact at a point is tangent to the object: k² =
    sin² a₀ + f ℓ²/4 is ½ (mechanics.md, "The uniform rod in closed form").
    """
    scene, clamp = shared
    gradient = jax.grad(scene.level)(point)
    n, r, t0 = gradient / jnp.sqrt(dot(gradient, gradient)), point - clamp.point, clamp.tangent
    plane = base_plane(n, n * dot(r, t0) - r * dot(n, t0), t0)
    return (2 - 4 * plane.sin_a0**2) / plane.lever_arm**2
