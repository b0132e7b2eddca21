"""The forward problem's entry point."""

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Motion, Status
from vibrissa.forward.assess import DEPTH_TOLERANCE, assessed
from vibrissa.forward.assess import WIDTH as ASSESSED
from vibrissa.forward.crease import caught
from vibrissa.forward.equations import NEUTRAL, Scene
from vibrissa.forward.events import Event, Happening
from vibrissa.forward.laws import FRICTIONLESS, RUBBING
from vibrissa.forward.march import Mode
from vibrissa.forward.path import Path, path_of
from vibrissa.forward.result import Scan
from vibrissa.forward.sweep import Sweep, sweep
from vibrissa.geometry.checks import not_negative
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Offset, Surface
from vibrissa.trail import Trail

_RESIDUAL_TOLERANCE = 1e-9


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
        Coulomb's coefficient for the rod on the object. The default is the paper's, 0.
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
    """
    friction = not_negative(friction, "friction")
    touched = touched_surface(rod, surface) if finite_radius else surface
    scene = Scene(touched, rod.length, friction)
    path = path_of(trail, rod.length)
    found = sweep(scene, path, RUBBING if friction > 0 else FRICTIONLESS)
    if np.all(found.status == Status.CLAMP_INSIDE):
        raise ValueError(
            f"trail.position = {trail.position.reshape(-1, 3)[0].tolist()} …: the clamp is inside the object; allowed is outside"
        )
    events = _events(found.happenings, rod, trail, path.stride, touched)
    return _result(rod, surface, trail, scene, path, found, events)


def touched_surface(rod: Rod, surface: Surface) -> Offset:
    """The object as the centre line of the rod meets it."""
    if rod.radius is None:
        raise ValueError("rod.radius = None; allowed with finite_radius is a number greater than 0")
    return Offset(surface, rod.radius)


def _result(
    rod: Rod,
    surface: Surface,
    trail: Trail,
    scene: Scene,
    path: Path,
    found: Sweep,
    events: list[Event],
) -> Scan:
    step, friction = path.stride, float(scene.friction)
    offset = scene.surface.radius if isinstance(scene.surface, Offset) else 0.0
    x, mode, figure, status = (
        part[:, ::step] for part in (found.x, found.mode, found.figure, found.status)
    )
    point, tangent = path.point[:, ::step], path.tangent[:, ::step]
    contact = mode == Mode.CONTACT
    columns, places = np.full((ASSESSED, mode.size), np.nan), np.full((*mode.shape, 3), np.nan)
    if contact.any():
        rows = np.flatnonzero(contact)
        clamps = np.concatenate([point[contact], tangent[contact]], axis=-1)
        values, places[contact] = assessed(scene, x[contact], clamps)
        for column, value in zip(columns, values.T, strict=True):
            column[rows] = value
    fields = np.moveaxis(columns.reshape(ASSESSED, *mode.shape), 0, -1)
    stuck, other_sides = _caught(scene, point, tangent, status, fields)
    status, contact = np.where(stuck, Status.PENETRATING, status), contact | stuck
    unsolved = (mode == Mode.LOST) & ~stuck
    phase, residual, depth = fields[..., 13], fields[..., 14], fields[..., 15]
    kind = np.where(
        contact, np.where(phase > 0, ContactKind.TANGENTIAL, ContactKind.TIP), ContactKind.NONE
    ).astype(np.int8)
    neutral = np.linalg.norm(np.cross(tangent, fields[..., 22:25]), axis=-1) < NEUTRAL
    turns = (
        [(figure > 0, Status.LATERALLY_UNSTABLE), (neutral, Status.HEAD_ON)]
        if friction == 0
        else []
    )
    status = _status(rod, status, contact, turns, fields)

    length, force_scale, moment_scale = rod.length, rod.force_scale, rod.moment_scale
    absent = np.where(unsolved, np.nan, 0.0)
    force = np.where(
        contact[..., None], -fields[..., 3:4] * fields[..., 22:25] * force_scale, absent[..., None]
    )
    moment = np.where(contact[..., None], fields[..., 8:11] * moment_scale, absent[..., None])
    shape = trail.shape
    reactions = Reactions(trail, force.reshape(*shape, 3), moment.reshape(*shape, 3))
    return Scan(
        rod, surface, trail,
        kind=kind.reshape(shape),
        point=(fields[..., :3] * length - offset * fields[..., 4:7]).reshape(*shape, 3),
        normal=fields[..., 4:7].reshape(*shape, 3),
        force_direction=fields[..., 22:25].reshape(*shape, 3),
        motion=_motion(kind, figure, friction).reshape(shape),
        arc_length=(fields[..., 7] * length).reshape(shape),
        reactions=reactions,
        energy=np.where(contact, fields[..., 11] * moment_scale, absent).reshape(shape),
        largest_curvature=np.where(contact, fields[..., 12] / length, absent).reshape(shape),
        contact_tangent=fields[..., 16:19].reshape(*shape, 3),
        plane_normal=fields[..., 19:22].reshape(*shape, 3),
        residual=residual.reshape(shape),
        depth=(depth * length).reshape(shape),
        status=status.astype(np.int8).reshape(shape),
        events=events,
        friction=friction,
        offset=offset,
        second_contact=_second_contacts(scene, places, other_sides, status == Status.PENETRATING).reshape(*shape, 3),
    )  # fmt: skip


def _caught(
    scene: Scene,
    point: Float[np.ndarray, "m n 3"],
    tangent: Float[np.ndarray, "m n 3"],
    status: np.ndarray,
    fields: Float[np.ndarray, "m n 25"],
) -> tuple[Bool[np.ndarray, "m n"], Float[np.ndarray, "m n 3"]]:
    """Fill in the rows of rods that are caught by their tips between two parts: which they are, and
    where they touch the second part.
    """
    jammed, places = status == Status.NO_EQUILIBRIUM, np.full(point.shape, np.nan)
    if not jammed.any() or scene.surface.parts_count == 1:
        return np.zeros_like(jammed), places
    rows = caught(scene, np.concatenate([point[jammed], tangent[jammed]], axis=-1))
    stuck = jammed.copy()
    stuck[jammed] = rows.found
    offset = scene.surface.radius / scene.length if isinstance(scene.surface, Offset) else 0.0
    fields[stuck] = rows.fields[rows.found]
    places[stuck] = (rows.fields[:, :3] - offset * rows.second_normal)[rows.found]
    return stuck, places


def _second_contacts(
    scene: Scene,
    deepest: Float[np.ndarray, "m n 3"],
    other_sides: Float[np.ndarray, "m n 3"],
    wrong: Bool[np.ndarray, "m n"],
) -> Float[np.ndarray, "m n 3"]:
    """Points of the object where rods lie deepest in it, or are caught."""
    places = other_sides * scene.length
    entered = wrong & np.isfinite(deepest).all(axis=-1)
    if entered.any():
        found = deepest[entered] * scene.length
        places[entered] = scene.surface.foot(found) if isinstance(scene.surface, Offset) else found
    return places


def _motion(
    kind: Int[np.ndarray, "m n"], figure: Float[np.ndarray, "m n"], friction: float
) -> Int[np.ndarray, "m n"]:
    at_rest = np.where(kind == ContactKind.TANGENTIAL, Motion.ROLL, Motion.STICK)
    moves = np.where((figure > 0) | (friction == 0), Motion.SLIP, at_rest)
    return np.where(kind == ContactKind.NONE, Motion.NONE, moves).astype(np.int8)


def _status(
    rod: Rod,
    status: np.ndarray,
    contact: np.ndarray,
    turns: list[tuple[Bool[np.ndarray, "m n"], Status]],
    fields: Float[np.ndarray, "m n 25"],
) -> np.ndarray:
    """The worst finding of each row, given those about the bending plane."""
    findings = [*turns, (fields[..., 15] > DEPTH_TOLERANCE, Status.PENETRATING)]
    if rod.yield_strain is not None and rod.radius is not None:
        findings.append(
            (fields[..., 12] * rod.radius / rod.length > rod.yield_strain, Status.OVERSTRAINED)
        )
    sound = (
        (fields[..., 14] <= _RESIDUAL_TOLERANCE)
        & (fields[..., 3] >= 0)
        & (fields[..., 7] <= 1 + _RESIDUAL_TOLERANCE)
    )
    findings.append((~sound, Status.NOT_CONVERGED))
    for wrong, finding in findings:
        status = np.where(contact & wrong, np.maximum(status, int(finding)), status)
    return status


def _events(
    happenings: list[Happening], rod: Rod, trail: Trail, stride: int, touched: Surface
) -> list[Event]:
    """The solver's happenings in the user's terms."""
    if not happenings:
        return []
    n = trail.count
    positions, parameters = trail.position.reshape(-1, n, 3), trail.parameter.reshape(-1, n)
    lane, index = (
        np.array(part)
        for part in zip(
            *((happening.lane, happening.index) for happening in happenings), strict=True
        )
    )
    share = (
        np.maximum(index - 1, 0)
        + np.array([happening.fraction for happening in happenings]) * (index > 0)
    ) / stride
    before = np.minimum(share.astype(int), max(n - 2, 0))
    after, fraction = np.minimum(before + 1, n - 1), share - before
    parameter = parameters[lane, before] * (1 - fraction) + parameters[lane, after] * fraction
    clamp = (
        positions[lane, before] * (1 - fraction)[:, None]
        + positions[lane, after] * fraction[:, None]
    )
    point = np.array([happening.point for happening in happenings]) * rod.length
    if isinstance(touched, Offset):
        point = touched.foot(point)
    kinds = (happening.kind for happening in happenings)
    return [
        Event(*parts)
        for parts in zip(kinds, lane.tolist(), parameter.tolist(), clamp, point, strict=True)
    ]
