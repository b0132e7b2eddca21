"""The forward problem's entry point."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contact import COULOMB, FRICTIONLESS, Law, Scene
from vibrissa.contacts import ContactKind, Motion, Status
from vibrissa.forward.assess import DEPTH_TOLERANCE, Assessment, assessed
from vibrissa.forward.events import Event, Happening
from vibrissa.forward.march import Mode
from vibrissa.forward.path import chosen, path_of
from vibrissa.forward.result import Scan
from vibrissa.forward.search import caught
from vibrissa.forward.sweep import Sweep, sweep
from vibrissa.geometry.checks import not_negative
from vibrissa.mechanics.model import NEUTRAL, Clamp
from vibrissa.numerics.lanes import WIDTH, in_threads, threads
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Offset, Surface
from vibrissa.trail import Trail

_RESIDUAL_TOLERANCE = 1e-9
"""Of the contact conditions, a thousand times what Newton's method leaves."""
_TRAILS = 512
"""Of a thread's share at most: what is done once a share then weighs little, and memory is some
30 MB.
"""


def scan(
    rod: Rod, surface: Surface, trail: Trail, *, friction: float = 0.0, finite_radius: bool = False
) -> Scan:
    """Quasi-static equilibria of a rod swept along an object, in one contact (paper, sections II
    and III).

    Parameters
    ----------
    rod
        Uniform straight rod.
    surface
        Object; smooth, in units of the rod.
    trail
        Clamp poses (n, …), or several trails (m, n, …), in units of the rod. The sweep runs in
        their order.
    friction
        Coulomb's coefficient between rod and object: 0 for none, as in the paper.
    finite_radius
        Whether the rod's skin touches, at its radius from the centre line, which rounds edges and
        corners. The default is the paper's: the centre line touches, and the object must be smooth.
        With friction the force still acts on the centre line, and its path stands for the skin's:
        the force's couple about the centre line and the turning of the section are left out, both
        of first order in the radius.

    Returns
    -------
    Scan
        One row a position; a row that could not be solved, or whose state fails a check, carries a
        status, the others their results.

    Raises
    ------
    ValueError
        If the clamp is inside the object at every position, the coefficient is negative or not
        finite, or a finite radius is wanted of a rod that has none.

    Notes
    -----
    The branch that continues from first contact is followed, also where it has become laterally
    unstable, with a status there. Steps longer than 0.05 L are divided. Of several equilibria at a
    position this is the one that the sweep reaches.

    With friction a state depends on all that went before: the contact sticks, slips or rolls, and
    the result converges with the trail's step. Behind a snap, and where a trail begins in contact
    without a smooth way in, the contact starts without tangential force. Stability against leaving
    the bending plane is not judged with friction.

    Many trails are shared out over the cores (`VIBRISSA_THREADS=1` keeps to one).
    """
    friction = not_negative(friction, "friction")
    touched = touched_surface(rod, surface) if finite_radius else surface
    scene = Scene(touched, rod.length, friction)
    law = COULOMB if friction > 0 else FRICTIONLESS
    path = path_of(trail, rod.length)
    count = len(path.point)

    # Whole blocks of lanes, and work for every thread.
    share = min(_TRAILS, WIDTH * -(-count // (WIDTH * threads())))

    def part(first: int) -> _Solved:
        own = np.s_[first : first + share]
        some = type(path)(path.point[own], path.orientation[own], path.stride)
        found = sweep(scene, some, law)
        return _solved(scene, law, some.clamps, path.stride, found)

    parts = in_threads(part, range(0, count, share))
    happenings = [
        happening.on(first * share)
        for first, part in enumerate(parts)
        for happening in part.happenings
    ]
    rows = [part._replace(happenings=()) for part in parts]
    solved: _Solved = jax.tree.map(lambda *arrays: np.concatenate(arrays), *rows)
    if np.all(solved.status == Status.CLAMP_INSIDE):
        first = trail.position.reshape(-1, 3)[0].tolist()
        raise ValueError(
            f"trail.position = {first} …: the clamp is inside the object; allowed is outside"
        )
    events = _events(happenings, rod, trail, path.stride, touched)
    return _result(rod, surface, trail, scene, solved, events)


def touched_surface(rod: Rod, surface: Surface) -> Offset:
    """The object as the centre line of the rod meets it."""
    if rod.radius is None:
        raise ValueError("rod.radius = None; allowed with finite_radius is a number greater than 0")
    return Offset(surface, rod.radius)


class _Solved(NamedTuple):
    """All rows of some trails (m, n), model units."""

    contact: Bool[np.ndarray, "m n"]
    lost: Bool[np.ndarray, "m n"]
    values: Assessment
    """NaN without contact."""
    figure: Float[np.ndarray, "m n"]
    status: Int[np.ndarray, "m n"]
    second_contact: Float[np.ndarray, "m n 3"]
    """Where the rod lies deepest in the object, or touches a second part."""
    happenings: Any


def _solved(scene: Scene, law: Law, clamps: Clamp, stride: int, found: Sweep) -> _Solved:
    clamps, steps, status = chosen((clamps, found.steps, found.status), np.s_[:, ::stride])
    contact, lost = steps.mode == Mode.CONTACT, steps.mode == Mode.LOST
    values, second = assessed(scene, law, *chosen((steps.reached.state, clamps), contact))

    def spread(rows: np.ndarray) -> np.ndarray:
        whole = np.full((*contact.shape, *rows.shape[1:]), np.nan)
        whole[contact] = rows
        return whole

    values, second, status = jax.tree.map(spread, values), spread(second), status.copy()
    # What no single contact explains may be a tip that is caught between two parts.
    jammed = np.argwhere(status == Status.NO_EQUILIBRIUM)
    if len(scene.surface.solids) > 1 and len(jammed):
        offset = scene.surface.radius / scene.length if isinstance(scene.surface, Offset) else 0.0
        for at, held in zip(
            map(tuple, jammed), caught(scene, chosen(clamps, tuple(jammed.T))), strict=True
        ):
            if held is not None:
                for whole, part in zip(values, held[0], strict=True):
                    whole[at] = part
                second[at] = held[0].point - offset * held[1]
                status[at], contact[at], lost[at] = Status.PENETRATING, True, False
    return _Solved(contact, lost, values, steps.figure, status, second, tuple(found.happenings))


def _result(
    rod: Rod, surface: Surface, trail: Trail, scene: Scene, solved: _Solved, events: list[Event]
) -> Scan:
    contact, values, shape = solved.contact, solved.values, trail.shape
    friction = float(scene.friction)
    offset = scene.surface.radius if isinstance(scene.surface, Offset) else 0.0
    tangential = np.where(values.phase > 0, ContactKind.TANGENTIAL, ContactKind.TIP)
    kind = np.where(contact, tangential, ContactKind.NONE).astype(np.int8)
    status = _status(rod, trail, friction, solved)
    absent = np.where(solved.lost, np.nan, 0.0)

    def known(where: np.ndarray, scale: float) -> Float[np.ndarray, "..."]:
        """A quantity that is zero without contact, and not known of unsolved rows."""
        missing = absent.reshape(absent.shape + (1,) * (where.ndim - 2))
        mask = contact.reshape(missing.shape)
        return np.where(mask, where * scale, missing).reshape(*shape, *where.shape[2:])

    def rows(values: np.ndarray, scale: float = 1.0) -> Float[np.ndarray, "..."]:
        return (values * scale).reshape(*shape, *values.shape[2:])

    force = -values.force[..., None] * values.direction
    reactions = Reactions(
        trail, known(force, rod.force_scale), known(values.moment, rod.moment_scale)
    )
    return Scan(
        rod,
        surface,
        trail,
        kind=rows(kind).astype(np.int8),
        point=rows(values.point * rod.length - offset * values.normal),
        normal=rows(values.normal),
        force_direction=rows(values.direction),
        motion=_motion(kind, solved.figure, friction).reshape(shape),
        arc_length=rows(values.arc_length, rod.length),
        reactions=reactions,
        energy=known(values.energy, rod.moment_scale),
        largest_curvature=known(values.largest_curvature, 1 / rod.length),
        contact_tangent=rows(values.tangent),
        plane_normal=rows(values.plane_normal),
        residual=rows(values.residual),
        depth=rows(values.depth, rod.length),
        status=status.reshape(shape),
        events=events,
        friction=friction,
        offset=offset,
        second_contact=rows(_second_contacts(scene, solved, (status == Status.PENETRATING))),
    )


def _second_contacts(
    scene: Scene, solved: _Solved, wrong: Bool[np.ndarray, "m n"]
) -> Float[np.ndarray, "m n 3"]:
    """Points of the object where rods lie deepest in it, or are caught."""
    places = np.where(wrong[..., None], solved.second_contact * scene.length, np.nan)
    entered = (solved.values.depth > DEPTH_TOLERANCE) & np.isfinite(places).all(axis=-1)
    if isinstance(scene.surface, Offset) and entered.any():
        places[entered] = scene.surface.foot(places[entered])
    return places


def _motion(
    kind: Int[np.ndarray, "m n"], figure: Float[np.ndarray, "m n"], friction: float
) -> Int[np.ndarray, "m n"]:
    at_rest = np.where(kind == ContactKind.TANGENTIAL, Motion.ROLL, Motion.STICK)
    moves = np.where((figure > 0) | (friction == 0), Motion.SLIP, at_rest)
    return np.where(kind == ContactKind.NONE, Motion.NONE, moves).astype(np.int8)


def _status(rod: Rod, trail: Trail, friction: float, solved: _Solved) -> Int[np.ndarray, "m n"]:
    """The worst finding of each row."""
    values = solved.values
    findings = [(values.depth > DEPTH_TOLERANCE, Status.PENETRATING)]
    if friction == 0:
        axis = trail.axis.reshape(*solved.contact.shape, 3)
        sine = np.linalg.norm(np.cross(axis, values.direction), axis=-1)
        findings += [
            (solved.figure > 0, Status.LATERALLY_UNSTABLE),
            (sine < NEUTRAL, Status.HEAD_ON),
        ]
    if rod.yield_strain is not None and rod.radius is not None:
        strain = values.largest_curvature * rod.radius / rod.length
        findings.append((strain > rod.yield_strain, Status.OVERSTRAINED))
    sound = (values.residual <= _RESIDUAL_TOLERANCE) & (values.force >= 0)
    sound &= values.arc_length <= 1 + _RESIDUAL_TOLERANCE
    findings.append((~sound, Status.NOT_CONVERGED))
    status = solved.status
    for wrong, finding in findings:
        worse = np.maximum(status, int(finding))
        status = np.where(solved.contact & wrong, worse, status)
    return status.astype(np.int8)


def _events(
    happenings: list[Happening], rod: Rod, trail: Trail, stride: int, touched: Surface
) -> list[Event]:
    """The solver's happenings in the user's terms."""
    if not happenings:
        return []
    n = trail.count
    positions, parameters = trail.position.reshape(-1, n, 3), trail.parameter.reshape(-1, n)
    lane, index = (
        np.array(part) for part in zip(*((at.lane, at.index) for at in happenings), strict=True)
    )
    fraction = np.array([happening.fraction for happening in happenings]) * (index > 0)
    share = (np.maximum(index - 1, 0) + fraction) / stride
    before = np.minimum(share.astype(int), max(n - 2, 0))
    after, share = np.minimum(before + 1, n - 1), share - before
    parameter = parameters[lane, before] * (1 - share) + parameters[lane, after] * share
    ends, share = (positions[lane, at] for at in (before, after)), share[:, None]
    clamp = next(ends) * (1 - share) + next(ends) * share
    point = np.array([happening.point for happening in happenings]) * rod.length
    if isinstance(touched, Offset):
        point = touched.foot(point)
    kinds = (happening.kind for happening in happenings)
    columns = kinds, lane.tolist(), parameter.tolist(), clamp, point
    return [Event(*parts) for parts in zip(*columns, strict=True)]
