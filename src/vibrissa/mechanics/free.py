"""The rod without contact, at many poses of the clamp."""

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from vibrissa.mechanics.model import Clamp, Resting, RodModel, clamp_of
from vibrissa.mechanics.models import model_of
from vibrissa.mechanics.shape import free_lines
from vibrissa.numerics.lanes import FEW, lanes
from vibrissa.numerics.vectors import dot
from vibrissa.rod import Rod
from vibrissa.trail import Trail

_DIGITS = 12
"""Decimals in which the axes of clamps agree that count as alike: all but the last few."""
_PLACES = 33
"""Along the rod, at which functions of its loads are asked for numbers."""


class FreeRod(NamedTuple):
    """What holds the free rod, and where its tip is; NaN if it falls over under its loads."""

    reactions: Float[Any, "*n wrench"]
    """About the clamp, world axes and the model's units."""
    ahead: Float[Any, "*n"]
    """How far the tip is ahead of the clamp along the clamp's axis [L]."""


def free_rods(
    rod: RodModel, position: Float[np.ndarray, "n 3"], orientation: Float[np.ndarray, "n 4"]
) -> FreeRod:
    """The free rod for clamps at these positions [L] with these orientations."""
    clamps = clamp_of(position, orientation)
    found: FreeRod = _free_rods(rod, clamps, at_rest(rod, clamps))
    return found


def at_rest(rod: RodModel, clamps: Clamp) -> Resting:
    """What rods without contact leave at their clamps (n, …): found once for each orientation,
    unless their loads depend on the position too.
    """
    count = len(clamps.point)
    if not rod.loaded:
        return Resting(np.zeros((count, 0)), np.ones(count, dtype=bool))
    told = np.hstack(clamps[1:] if rod.alike_everywhere else clamps).round(_DIGITS)
    # Of neighbours that are alike only the first is compared with the others.
    changes = np.ones(count, dtype=bool)
    changes[1:] = np.any(told[1:] != told[:-1], axis=1)
    begin = np.flatnonzero(changes)
    _, first, own = np.unique(told[begin], axis=0, return_index=True, return_inverse=True)
    found: Any = _at_rest(rod, jax.tree.map(lambda part: part[begin[first]], clamps))
    return Resting(*(part[own.ravel()[np.cumsum(changes) - 1]] for part in found))


@lanes(alone=FEW, by_call=True)
def _at_rest(rod: RodModel, clamp: Clamp) -> Resting:
    free = rod.free(clamp)
    return Resting(-free.reactions, jnp.asarray(free.sound))


@lanes(alone=FEW)
def _free_rods(rod: RodModel, clamp: Clamp, resting: Resting) -> FreeRod:
    free = rod.free(clamp, resting)
    tip, *_ = free.at(jnp.ones(()))
    ahead = dot(tip - clamp.point, clamp.tangent)
    return FreeRod(*(jnp.where(free.sound, part, jnp.nan) for part in (free.reactions, ahead)))


def free_reactions(rod: Rod, trail: Trail) -> Float[np.ndarray, "n 6"]:
    """Reactions on the rod without contact, world axes, about the clamp [N], [N m].

    Raises
    ------
    ValueError
        If the rod has no stable shape without contact.
    """
    if rod.loads is None:
        return np.zeros((trail.count, 6))
    found: Any = free_rods(model_of(rod), trail.position / rod.length, trail.orientation)
    check_loads(rod, trail, np.isnan(found.ahead))
    check_stands(found.ahead)
    return found.reactions * np.repeat([rod.force_scale, rod.moment_scale], 3)


def check_loads(rod: Rod, trail: Trail, fallen: Bool[np.ndarray, "*n"]) -> None:
    """Where a rod falls over, refuse a function of its loads that gives no finite numbers along it.

    Raises
    ------
    ValueError
        If there is one.
    """
    if rod.loads is None or not fallen.any():
        return
    first = int(np.argmax(fallen))
    pose = (part.reshape(-1, part.shape[-1])[first] for part in (trail.position, trail.orientation))
    points = free_lines(replace(rod, loads=None), Trail(*(part[None] for part in pose)), _PLACES)[0]
    tangents = np.gradient(points, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    rod.loads.check_finite(np.linspace(0, rod.length, _PLACES), points, tangents)


def check_stands(ahead: Float[Any, "n"]) -> None:
    """Refuse a rod that falls over in any of the poses."""
    if np.isnan(ahead).any():
        raise ValueError("without contact the rod falls over under its loads: it has no shape")
