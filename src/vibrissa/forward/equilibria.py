"""All equilibria at one clamp pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.brief import brief
from vibrissa.contact import FRICTIONLESS, Scene, State, Touching, touching
from vibrissa.contacts import ContactKind
from vibrissa.forward.assess import DEPTH_TOLERANCE
from vibrissa.forward.path import chosen
from vibrissa.forward.scan import touched_surface
from vibrissa.forward.search import eased, seeds_around, solutions
from vibrissa.forward.second_variation import NODES, Shape, least_second_variation
from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import Orientation, unit_quaternions
from vibrissa.mechanics.elastic_line import directors, elastic_line
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.kirchhoff import Kirchhoff
from vibrissa.mechanics.model import Clamp, RodModel, clamp_of
from vibrissa.mechanics.models import spatial
from vibrissa.numerics.lanes import lanes
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Offset, Surface
from vibrissa.trail import Trail

# Starting magnitudes of the force [EI/L²] for Newton's method, by number of inflections: about
# (2K/s₁)² and more.
_FORCES = ((0.05, 0.5, 1.5, 4.0, 8.0), (12.0, 20.0, 30.0, 45.0), (50.0, 75.0, 110.0))
_CONVERGED = 1e-10
_LINE_POINTS = 401


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One admissible equilibrium of a clamped rod with one frictionless contact, in units of the
    rod, world axes.

    Attributes
    ----------
    kind
        Tip or tangential contact.
    point, normal
        Contact point on the object and outward unit normal there (3,).
    arc_length
        s₁ [m].
    reactions
        Support reactions of the one pose: force (1, 3) and moment (1, 3).
    energy
        Bending energy [J].
    stable
        Whether the second variation of the energy is positive under the constraint of contact.
    second_variation
        Its least eigenvalue per ∫ ‖δt‖² ds [N]: how far the equilibrium is from instability, or
        into it.
    inflections
        How often the curvature changes sign between clamp and contact.
    elastic_line
        401 points (401, 3) equally spaced in arc length from clamp to tip.
    """

    kind: ContactKind
    point: Float[np.ndarray, "3"]
    normal: Float[np.ndarray, "3"]
    arc_length: float
    reactions: Reactions
    energy: float
    stable: bool
    second_variation: float
    inflections: int
    elastic_line: Float[np.ndarray, "401 3"]

    __repr__ = brief


def equilibria(
    rod: Rod,
    surface: Surface,
    *,
    position: ArrayLike,
    orientation: Orientation = (0.0, 0.0, 0.0, 1.0),
    finite_radius: bool = False,
) -> list[Equilibrium]:
    """All admissible equilibria found at a clamp pose, lowest energy first: stable and unstable,
    with up to two inflections of the rod.

    Parameters
    ----------
    rod, surface
        As for `scan`; without friction.
    position, orientation
        Clamp point (3,) in units of the rod, and quaternion x, y, z, w (4,) or SciPy `Rotation`
        that maps clamp axes onto world axes.
    finite_radius
        As for `scan`.

    Returns
    -------
    list
        Empty if none was found, for instance where the object is out of reach. The free rod
        without contact is not listed.

    Raises
    ------
    ValueError
        If the clamp is inside the object, a shape does not fit, or an entry is not finite.

    Notes
    -----
    Newton's method starts from several hundred points on the object in all directions and from
    several magnitudes of the force, for each number of inflections. Such a search can miss an
    equilibrium; in the paper's case it finds the known ones (mechanics.md).
    """
    clamp = finite_array(position, "position", last=3, ndim=1)
    turn = unit_quaternions(orientation, "orientation")
    if turn.shape != (4,):
        raise ValueError(f"orientation has shape {turn.shape}; allowed is one quaternion (4,)")
    touched = touched_surface(rod, surface) if finite_radius else surface
    if float(touched.levels(clamp)) < 0:
        raise ValueError(
            f"position = {clamp.tolist()}: the clamp is inside the object; allowed is outside"
        )
    pose, base = Trail(clamp[None], turn[None]), clamp_of(clamp / rod.length, turn)
    found: list[Equilibrium] = []
    for model, forces in _models(rod):
        scene = Scene(touched, rod.length, rod=model)
        seeds = eased(scene, base, seeds_around(scene, base, [], forces))
        state = solutions(scene, base, FRICTIONLESS, seeds).state
        count = len(state.force)
        seen = _seen(scene, state, Clamp(*(np.tile(part, (count, 1)) for part in base)))
        for row in range(count):
            equilibrium = _described(rod, scene, pose, base, *chosen((state, seen), row))
            if equilibrium is not None:
                found.append(equilibrium)
    return sorted(found, key=lambda equilibrium: equilibrium.energy)


def _models(rod: Rod) -> list[tuple[RodModel, tuple[float, ...]]]:
    """Models of the rod, and the forces with which to search for equilibria: in closed form each
    number of inflections is one of its own.
    """
    if not rod.plain:
        # Far from the start, derivatives of the rod itself lead to more of them.
        return [(replace(spatial(rod), roughly=None), tuple(chain(*_FORCES)))]
    return [(Elastica(count), forces) for count, forces in enumerate(_FORCES)]


class _Seen(NamedTuple):
    """A solution, and the shape of a rod that is not known in closed form."""

    found: Touching
    energy: Float[Any, ""]
    along: Any = None
    """As `Kirchhoff.along` returns it."""
    line: Float[Any, "401 3"] | None = None


@lanes(width=1, blocks=64)
def _seen(scene: Scene, state: State, clamp: Clamp) -> _Seen:
    rod, found = scene.rod, touching(scene, FRICTIONLESS, state, clamp)
    seen = _Seen(found, rod.energy(found.bent))
    if not isinstance(rod, Kirchhoff):
        return seen
    nodes = np.linspace(0, 1, NODES) * jnp.minimum(found.bent.arc_length, 1.0)
    return seen._replace(
        along=rod.along(found.bent, nodes),
        line=rod.drawn(found.bent, np.linspace(0, 1, _LINE_POINTS)),
    )


def _shape(model: RodModel, clamp: Clamp, seen: _Seen) -> tuple[Shape, int, np.ndarray]:
    """A rod's shape up to the contact, its inflections, and points from clamp to tip."""
    bent = seen.found.bent
    if isinstance(model, Elastica):
        n, s1 = bent.direction, float(bent.arc_length)
        side = np.asarray(model.side(bent)) * (-1.0) ** model.inflections
        given = (n, side, float(bent.force), float(bent.incidence), s1)
        tangent, curvature, normal = directors(*given, np.linspace(0, s1, NODES))
        one, force = np.ones(NODES), np.broadcast_to(bent.force * n, (NODES, 3))
        shape = Shape(tangent, -curvature[:, None] * normal, force, one, one)
        line = elastic_line(bent.to_contact, *given, np.linspace(0, 1, _LINE_POINTS))
        return shape, model.inflections, clamp.point + line
    assert isinstance(model, Kirchhoff) and seen.line is not None
    support = model.compliance
    if support is not None:
        axes = np.stack([clamp.across, np.cross(clamp.tangent, clamp.across), clamp.tangent], 1)
        support = axes @ np.asarray(support)[3:, 3:] @ axes.T
    tangent, moment, force, bending, torsion = seen.along
    shape = Shape(tangent, moment, force, bending, torsion, support)
    inner = shape.moment[:-1]
    inflections = int(np.sum(np.sum(inner[1:] * inner[:-1], axis=1) < 0))
    return shape, inflections, seen.line


def _described(
    rod: Rod, scene: Scene, pose: Trail, clamp: Clamp, state: State, seen: _Seen
) -> Equilibrium | None:
    """The solution in the user's terms, or None if it is not admissible."""
    found, bent, n = seen.found, seen.found.bent, seen.found.push.normal
    s1, away = float(bent.arc_length), 0.5 - float(bent.incidence)
    met = np.abs(found.residual).max() < _CONVERGED
    if not (met and s1 <= 1 + _CONVERGED and away >= -_CONVERGED):
        return None
    shape, inflections, line = _shape(scene.rod, clamp, seen)
    if inflections >= len(_FORCES):
        return None
    levels = scene.surface.levels(line * rod.length) / rod.length
    if scene.slims:
        levels = levels + np.asarray(jax.vmap(scene.slack)(jnp.linspace(0, 1, _LINE_POINTS)))
    if -float(levels.min()) > DEPTH_TOLERANCE:
        return None
    tangential = (1 - s1) > away
    point = np.asarray(state.point)
    variation = least_second_variation(
        scene, point, float(state.force), shape, s1, tangential=tangential
    )
    contact = point * rod.length
    force, moment = np.asarray(bent.support_force), np.asarray(bent.base_moment)
    return Equilibrium(
        kind=ContactKind.TANGENTIAL if tangential else ContactKind.TIP,
        point=scene.surface.foot(contact) if isinstance(scene.surface, Offset) else contact,
        normal=n,
        arc_length=s1 * rod.length,
        reactions=Reactions(pose, force[None] * rod.force_scale, moment[None] * rod.moment_scale),
        energy=float(seen.energy) * rod.moment_scale,
        stable=variation > 0,
        second_variation=variation * rod.force_scale,
        inflections=inflections,
        elastic_line=line * rod.length,
    )
