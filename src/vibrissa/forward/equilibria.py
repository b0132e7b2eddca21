"""All equilibria at one clamp pose."""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vibrissa.brief import brief
from vibrissa.contact import FRICTIONLESS, Scene, State, Touching, touching
from vibrissa.contacts import ContactKind
from vibrissa.forward.assess import DEPTH_TOLERANCE
from vibrissa.forward.branches import FORCES, contacts_of, in_closed_form
from vibrissa.forward.path import chosen
from vibrissa.forward.scan import touched_surface
from vibrissa.forward.search import different
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

_CONVERGED = 1e-10
_STEPS = 48
"""Of a rod under large forces, as of two inflections close to the clamp."""
_ASIDE = 1e-4
"""Angle [rad] by which a solution is turned to see whether it remains one."""
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
        Whether the second variation of the energy is positive under the constraint of contact. An
        equilibrium that is one of a circle is neutral along it; this is about all other changes.
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
    """All admissible equilibria found at a clamp pose, lowest potential first: stable and unstable,
    with up to two inflections of the rod.

    The potential is the energy of bending, of the support and of the loads. Where it stays as it
    is when the bent rod turns about the clamp's axis, as a straight rod's does that points at the
    centre of a ball or straight down onto a plane, equilibria form circles. One of each circle is
    listed: the one whose contact lies on the side of the clamp's x axis or, if only an arc of the
    circle is possible, as on a face that has edges, some other.

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
    several magnitudes of the force, for each number of inflections. Equilibria of a rod without a
    closed form are also followed from those of a straight, uniform one while it becomes the other.
    Such a search can miss an equilibrium; in the paper's case it finds the known ones
    (mechanics.md).
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
    found: list[tuple[float, Equilibrium]] = []
    for scene, state in _solved(rod, touched, base):
        single, seen = _one_of_each_circle(scene, state, base)
        for row in range(len(single.force)):
            one = _described(rod, scene, pose, base, *chosen((single, seen), row))
            if one is not None:
                found.append((float(seen.potential[row]), one))
    return [one for _, one in sorted(found, key=itemgetter(0))]


def _solved(rod: Rod, touched: Surface, clamp: Clamp) -> list[tuple[Scene, State]]:
    """Contacts (k, …) of a rod: in closed form each number of inflections is a model of its own."""
    scene = Scene(touched, rod.length)
    plain = [in_closed_form(scene, clamp, count) for count in range(len(FORCES))]
    if rod.plain:
        return plain
    # One of each circle leads to one of each.
    starts = [_one_of_each_circle(*each, clamp)[0] for each in plain]
    together = jax.tree.map(lambda *parts: np.concatenate(parts), *starts)
    return [contacts_of(spatial(rod, _STEPS), scene, clamp, together)]


class _Seen(NamedTuple):
    """A solution, and the shape of a rod that is not known in closed form."""

    found: Touching
    energy: Float[Any, ""]
    potential: Float[Any, ""]
    turns: Any = None
    """Whether it remains one when it turns about the clamp's axis."""
    along: Any = None
    """As `Kirchhoff.along` returns it."""
    line: Float[Any, "401 3"] | None = None


@lanes(width=1, blocks=64)
def _seen(scene: Scene, state: State, clamp: Clamp) -> _Seen:
    rod, found = scene.rod, touching(scene, FRICTIONLESS, state, clamp)
    seen = _Seen(found, rod.energy(found.bent), rod.potential(found.bent))
    if not isinstance(rod, Kirchhoff):
        return seen
    nodes = np.linspace(0, 1, NODES) * jnp.minimum(found.bent.arc_length, 1.0)
    return seen._replace(
        along=rod.along(found.bent, nodes),
        line=rod.drawn(found.bent, np.linspace(0, 1, _LINE_POINTS)),
    )


def _one_of_each_circle(scene: Scene, state: State, clamp: Clamp) -> tuple[State, _Seen]:
    """Of solutions that remain some as they turn about the clamp's axis, one for each circle: with
    its contact on the side of the clamp's x axis, if that is one too; and all others.
    """
    count, side = len(state.force), np.cross(clamp.tangent, clamp.across)
    clamps = Clamp(*(np.tile(part, (count, 1)) for part in clamp))
    reach = state.point - clamp.point
    home = _turned(state, clamp, -np.arctan2(reach @ side, reach @ clamp.across))
    aside = _turned(state, clamp, np.full(count, _ASIDE))
    own, there, beside = (_seen(scene, each, clamps) for each in (state, home, aside))
    residuals = (np.abs(each.found.residual).max(axis=1, initial=0.0) for each in (beside, there))
    turns, solved = (residual < _CONVERGED for residual in residuals)

    def either(which: Bool[np.ndarray, "k"], turned: Any, found: Any) -> Any:
        return jax.tree.map(
            lambda one, other: np.where(which.reshape(-1, *(1,) * (one.ndim - 1)), one, other),
            turned,
            found,
        )

    kept = different(either(turns, home, state))
    states, seen = either(turns & solved, (home, there), (state, own))
    single: tuple[State, _Seen] = chosen((states, seen._replace(turns=turns)), kept)
    return single


def _turned(state: State, clamp: Clamp, angle: Float[np.ndarray, "k"]) -> State:
    """States (k, …) turned about the clamp's axis."""
    turn = Rotation.from_rotvec(angle[:, None] * clamp.tangent).as_matrix()
    point = clamp.point + np.einsum("kij,kj->ki", turn, state.point - clamp.point)
    # A force and a moment, where there are loads.
    vectors = state.own.reshape(len(angle), state.own.shape[1] // 3, 3)
    own = np.einsum("kij,knj->kni", turn, vectors).reshape(state.own.shape)
    return state._replace(point=point, own=own)


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
    inflections = int(np.sum(np.sum(inner[1:] * inner[:-1], axis=1) < -(_CONVERGED**2)))
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
    if inflections >= len(FORCES):
        return None
    levels = scene.surface.levels(line * rod.length) / rod.length
    if scene.slims:
        levels = levels + np.asarray(jax.vmap(scene.slack)(jnp.linspace(0, 1, _LINE_POINTS)))
    if -float(levels.min()) > DEPTH_TOLERANCE:
        return None
    tangential = (1 - s1) > away
    point = np.asarray(state.point)
    variation = least_second_variation(
        scene,
        point,
        float(state.force),
        shape,
        s1,
        tangential=tangential,
        turns_about=clamp.tangent if seen.turns else None,
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
