"""All equilibria at one clamp pose."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import ellipj

from vibrissa.contacts import ContactKind
from vibrissa.forward.assess import DEPTH_TOLERANCE
from vibrissa.forward.equations import Clamp, Scene, contact_state
from vibrissa.forward.scan import touched_surface
from vibrissa.forward.search import eased, seeds_around, solved_from
from vibrissa.forward.second_variation import NODES, least_second_variation
from vibrissa.geometry.checks import finite_array
from vibrissa.geometry.rotation import third_axis, unit_quaternions
from vibrissa.mechanics.elastic_line import elastic_line
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Offset, Surface
from vibrissa.trail import Trail

# Magnitudes of the force [EI/L²] from which Newton's method starts, by the number of inflections:
# about (2K/s₁)² and more.
_FORCES = ((0.05, 0.5, 1.5, 4.0, 8.0), (12.0, 20.0, 30.0, 45.0), (50.0, 75.0, 110.0))
_SAME = 1e-6
_CONVERGED = 1e-10
_LINE_POINTS = 401


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """One admissible equilibrium of a clamped rod in one frictionless contact, in units of the rod,
    world axes.

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
        Its least eigenvalue per ∫ ‖δt‖² ds [N]: how far from, or how deep in, instability.
    inflections
        How often the curvature changes its sign between clamp and contact.
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


def equilibria(
    rod: Rod,
    surface: Surface,
    *,
    position: ArrayLike,
    orientation: "ArrayLike | Rotation" = (0.0, 0.0, 0.0, 1.0),
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
        Empty if none was found, as where the object is out of reach. The straight rod without
        contact is not listed.

    Raises
    ------
    ValueError
        If the clamp is inside the object, a shape does not fit, or an entry is not finite.

    Notes
    -----
    Newton's method starts from several hundred places on the object in all directions and from
    several magnitudes of the force, for each number of inflections. A search from starting points
    can miss an equilibrium; on the paper's case it finds those known (mechanics.md).
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
    scene, pose = Scene(touched, rod.length), Trail(clamp[None], turn[None])
    base, axis = clamp / rod.length, third_axis(turn)
    found: list[Equilibrium] = []
    for inflections, forces in enumerate(_FORCES):
        for x in _solutions(scene, base, axis, inflections, forces):
            equilibrium = _described(rod, scene, pose, x, inflections)
            if equilibrium is not None:
                found.append(equilibrium)
    return sorted(found, key=lambda equilibrium: equilibrium.energy)


def _solutions(
    scene: Scene,
    point: Float[np.ndarray, "3"],
    axis: Float[np.ndarray, "3"],
    inflections: int,
    forces: tuple[float, ...],
) -> list[Float[np.ndarray, "4"]]:
    seeds = seeds_around(scene, point, axis, [], forces)
    if not len(seeds):
        return []
    clamp = np.concatenate([point, axis])
    return list(
        solved_from(scene, eased(scene, seeds, clamp, inflections), clamp, inflections)
        .distinct(clamp)
        .x
    )


def _described(
    rod: Rod, scene: Scene, pose: Trail, x: Float[np.ndarray, "4"], inflections: int
) -> Equilibrium | None:
    """The solution in the user's terms, or None if it is not admissible."""
    axis, clamp = pose.axis[0], pose.position[0] / rod.length
    state = contact_state(
        scene, jnp.asarray(x), Clamp(jnp.asarray(clamp), jnp.asarray(axis)), inflections
    )
    n, r, force = np.asarray(state.normal), np.asarray(state.to_contact), float(x[3])
    k2, s1 = float(state.rod.modulus), float(state.rod.arc_length)
    if not (
        np.abs(np.asarray(state.residual)).max() < _CONVERGED
        and s1 <= 1 + _CONVERGED
        and k2 <= 0.5 + _CONVERGED
    ):
        return None
    side = (r - (r @ n) * n) / float(state.plane.lever_arm) * (-1.0) ** inflections
    s = np.linspace(0, 1, _LINE_POINTS)
    line = clamp + elastic_line(r, n, side, force, k2, s1, s)
    if -float(scene.surface.levels(line * rod.length).min()) / rod.length > DEPTH_TOLERANCE:
        return None
    tangential = (1 - s1) > (0.5 - k2)
    nodes = np.linspace(0, s1, NODES)
    tangent, curvature, plane_normal = _directors(n, side, force, k2, s1, nodes)
    variation = least_second_variation(
        scene, x[:3], force, tangent, curvature, plane_normal, s1, tangential=tangential
    )
    contact = x[:3] * rod.length
    support = -force * n
    return Equilibrium(
        kind=ContactKind.TANGENTIAL if tangential else ContactKind.TIP,
        point=scene.surface.foot(contact) if isinstance(scene.surface, Offset) else contact,
        normal=n,
        arc_length=s1 * rod.length,
        reactions=Reactions(
            pose, support[None] * rod.force_scale, np.cross(r, support)[None] * rod.moment_scale
        ),
        energy=force * (float(state.rod.advance) - (1 - 2 * k2) * s1) * rod.moment_scale,
        stable=variation > 0,
        second_variation=variation * rod.force_scale,
        inflections=inflections,
        elastic_line=line * rod.length,
    )


def _directors(
    n: Float[np.ndarray, "3"],
    side: Float[np.ndarray, "3"],
    force: float,
    k2: float,
    s1: float,
    s: Float[np.ndarray, "nodes"],
) -> tuple[Float[np.ndarray, "nodes 3"], Float[np.ndarray, "nodes"], Float[np.ndarray, "3"]]:
    """Tangents, curvatures about the plane's normal, and that normal: with u = √f (s₁ − s), sin a =
    k cd u and κ = 2 √f k k' sd u.
    """
    u = np.sqrt(force) * (s1 - s)
    sn, cn, dn, _ = ellipj(u, k2)
    sine = np.sqrt(k2) * cn / dn
    cosine = np.sqrt(1 - k2) / dn
    tangent = -(1 - 2 * sine**2)[:, None] * n + (2 * sine * cosine)[:, None] * side
    return tangent, 2 * np.sqrt(force * k2 * (1 - k2)) * sn / dn, np.cross(side, n) * -1.0
