"""All equilibria at one clamp pose."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.brief import brief
from vibrissa.contact import FRICTIONLESS, Scene, State, touching
from vibrissa.contacts import ContactKind
from vibrissa.forward.assess import DEPTH_TOLERANCE
from vibrissa.forward.path import chosen, clamp_of
from vibrissa.forward.scan import touched_surface
from vibrissa.forward.search import eased, seeds_around, solutions
from vibrissa.forward.second_variation import NODES, least_second_variation
from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import Orientation, unit_quaternions
from vibrissa.mechanics.elastic_line import directors, elastic_line
from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.model import Clamp
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
    pose, scene = Trail(clamp[None], turn[None]), Scene(touched, rod.length)
    base = clamp_of(clamp / rod.length, turn)
    found: list[Equilibrium] = []
    for inflections, forces in enumerate(_FORCES):
        bent = scene._replace(rod=Elastica(inflections))
        seeds = eased(bent, base, seeds_around(bent, base, [], forces))
        state = solutions(bent, base, FRICTIONLESS, seeds).state
        for row in range(len(state.force)):
            equilibrium = _described(rod, bent, pose, base, chosen(state, row), inflections)
            if equilibrium is not None:
                found.append(equilibrium)
    return sorted(found, key=lambda equilibrium: equilibrium.energy)


def _described(
    rod: Rod, scene: Scene, pose: Trail, clamp: Clamp, state: State, inflections: int
) -> Equilibrium | None:
    """The solution in the user's terms, or None if it is not admissible."""
    state, at = (jax.tree.map(jnp.asarray, part) for part in (state, clamp))
    found = touching(scene, FRICTIONLESS, state, at)
    bent, n = found.bent, np.asarray(found.push.normal)
    s1, away = float(bent.arc_length), 0.5 - float(bent.incidence)
    met = np.abs(np.asarray(found.residual)).max() < _CONVERGED
    if not (met and s1 <= 1 + _CONVERGED and away >= -_CONVERGED):
        return None
    side = np.asarray(Elastica().side(bent)) * (-1.0) ** inflections
    shape = (n, side, float(state.force), float(bent.incidence), s1)
    reach = np.asarray(bent.to_contact)
    line = clamp.point + elastic_line(reach, *shape, np.linspace(0, 1, _LINE_POINTS))
    if -float(scene.surface.levels(line * rod.length).min()) / rod.length > DEPTH_TOLERANCE:
        return None
    tangential = (1 - s1) > away
    tangent, curvature, plane_normal = directors(*shape, np.linspace(0, s1, NODES))
    point = np.asarray(state.point)
    variation = least_second_variation(
        scene,
        point,
        float(state.force),
        tangent,
        curvature,
        plane_normal,
        s1,
        tangential=tangential,
    )
    contact = point * rod.length
    force, moment = -float(state.force) * n, np.asarray(bent.base_moment)
    return Equilibrium(
        kind=ContactKind.TANGENTIAL if tangential else ContactKind.TIP,
        point=scene.surface.foot(contact) if isinstance(scene.surface, Offset) else contact,
        normal=n,
        arc_length=s1 * rod.length,
        reactions=Reactions(pose, force[None] * rod.force_scale, moment[None] * rod.moment_scale),
        energy=float(scene.rod.energy(bent)) * rod.moment_scale,
        stable=variation > 0,
        second_variation=variation * rod.force_scale,
        inflections=inflections,
        elastic_line=line * rod.length,
    )
