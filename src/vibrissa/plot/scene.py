"""A sweep in space: object, rods, contacts and events."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from mpl_toolkits.mplot3d import Axes3D

from vibrissa.contacts import Contacts, Status
from vibrissa.drawing import FREE, drawn_rods
from vibrissa.forward import Scan
from vibrissa.forward.events import Event
from vibrissa.inverse import Reconstruction
from vibrissa.mechanics.shape import free_lines
from vibrissa.plot import space
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import no_contact, status_words
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.surfaces.outline import box_of, outline
from vibrissa.trail import Trail

_SAMPLES = 90
"""Points of a drawn rod: its segments are invisible at the width of a page."""
_ARROW = 0.15
"""Length of a drawn direction, and of the largest force of a recording, in rod lengths."""


class Shown(NamedTuple):
    """What a scene holds, in units of the rod."""

    path: Float[np.ndarray, "trail n 3"]
    contacts: Contacts | None = None
    """One row per point."""
    rods: space.Segments = space.NOTHING
    arrows: tuple[space.Arrows, ...] = ()
    events: tuple[Event, ...] = ()
    lost: Int[np.ndarray, "lost"] = np.zeros(0, dtype=int)
    """Status of the positions that have neither a contact nor none."""


@checked
def scene(
    what: Scan | Reconstruction | Reactions | Contacts | Surface,
    *,
    rod: Rod | None = None,
    surface: Surface | None = None,
    trails: Sequence[int] | None = None,
    rods: int = 20,
    directions: bool = False,
    events: bool = True,
    box: tuple[Sequence[float], Sequence[float]] | None = None,
    view: tuple[float, float] | None = None,
    axes: Axes3D | None = None,
) -> Axes3D:
    """Object, rods, contact points with their uncertainty, trails and events.

    Rods are red in tip contact, blue in tangential contact, black behind the contact, grey without
    contact, and faint behind the object. Contacts whose status is not OK are crosses. Known
    uncertainties are drawn as the principal axes of 95 % ellipsoids. A recording is shown as forces
    on the free rod.

    Parameters
    ----------
    what
        Scan, reconstruction, reactions of a recording, contacts, or an object on its own.
    rod
        Rod of a recording, of contacts or of an object; scans and reconstructions know theirs.
    surface
        Object, in units of the rod; by default that of a scan.
    trails
        Which of several trails are shown; by default all.
    rods
        How many rods are drawn for each trail, at equal numbers of positions from one to the next.
    directions
        Whether the object's normal and the direction of the force are drawn at these rods.
    events
        Whether the events of a scan are marked.
    box
        Least and largest coordinates of the part of the object to draw, in units of the rod; by
        default what surrounds the contacts, or the origin if there are none.
    view
        Elevation and azimuth of the eye [°]; by default where most contacts face it, from above if
        half of them do.
    axes
        Axes in space to draw in; by default those of a new figure.

    Returns
    -------
    Axes3D
        Axes in millimetres, or in rod lengths for a rod in model units.

    Raises
    ------
    TypeError
        If `what` is something else.
    ValueError
        If the rod is needed and not given, there are no such trails, `rods` is negative, the box is
        none, or there is nothing to draw.
    ImportError
        If the object cannot be drawn without `vibrissa[mesh]`, and that is not installed.
    """
    rod = what.rod if isinstance(what, Scan | Reconstruction) else rod
    if rod is None:
        raise ValueError(
            f"rod = None: {type(what).__name__} does not say its unit of length; "
            "allowed is the rod that it belongs to"
        )
    if isinstance(what, Scan | Surface):
        surface = surface or (what.surface if isinstance(what, Scan) else what)
    shown = shown_of(what, rod, trails, rods, directions=directions)
    stage, around = staged(shown, rod, surface, box, view, axes)
    draw_moving(stage, shown)
    for arrows in shown.arrows:
        stage.draw_arrows(arrows)
    if events:
        stage.draw_events(shown.events)
    return stage.framed(around)


def staged(
    shown: Shown,
    rod: Rod,
    surface: Surface | None,
    box: tuple[Sequence[float], Sequence[float]] | None,
    view: tuple[float, float] | None,
    axes: Axes3D | None = None,
) -> tuple[space.Stage, space.Points]:
    """Axes with the object and the paths of the clamp, and points that they are to hold."""
    touched = shown.path[:0, 0]
    if shown.contacts is not None and len(shown.contacts):
        # Contacts that could be anywhere do not decide what is shown.
        wide = space.is_wide(shown.contacts, rod)
        touched = shown.contacts.point[~wide if not wide.all() else wide]
    places = touched, shown.rods.ends, shown.path, *(arrows.ends for arrows in shown.arrows)
    around = np.vstack([place.reshape(-1, 3) for place in places])
    edges = None
    if surface is not None:
        near = touched if len(touched) else around
        edges = _checked(box) if box is not None else _around(surface, near, rod)
    if edges is None:
        surface, edges = None, (np.zeros(3), np.zeros(3))
    triangles = np.zeros((0, 3, 3)) if surface is None else outline(surface, *edges)
    around = np.vstack([around, triangles.reshape(-1, 3)])
    if not len(around):
        raise ValueError(
            "nothing to draw: no object is found "
            f"{'near the origin' if box is None else 'within box'}; "
            "allowed is a box that its surface crosses"
        )
    eye = view or space.eye_of(shown.contacts)
    stage = space.Stage.at(eye, rod, surface, edges, axes)
    if len(triangles):
        stage.draw_object(triangles)
    stage.draw_paths(shown.path)
    return stage, around


def _around(surface: Surface, near: space.Points, rod: Rod) -> space.Box | None:
    """The part of an object to draw: near some points, or, if there are none, where it is nearest
    to the origin.
    """
    if len(near):
        return box_of(surface, near, rod.length, beyond=rod.length / 8)
    # The centre of a ball has no nearest point; what is beside it has.
    nearest = surface.nearest(np.full(3, 1e-3 * rod.length))
    return box_of(surface, nearest[None], 2 * rod.length, beyond=rod.length / 2)


def _checked(box: tuple[Sequence[float], Sequence[float]]) -> space.Box:
    low, high = np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float)
    if low.shape != (3,) or high.shape != (3,) or not np.all(low < high):
        raise ValueError(f"box = {box}; allowed are three least coordinates and three larger ones")
    return low, high


def draw_moving(stage: space.Stage, shown: Shown) -> None:
    """Contacts and rods."""
    if shown.contacts is not None:
        stage.draw_contacts(shown.contacts, size=1.8 if len(shown.rods.ends) else 4.0)
    stage.draw_rods(shown.rods)
    if len(shown.lost):
        stage.explain(f"not drawn: {status_words(shown.lost)}", linestyle="none")


def shown_of(
    what: Scan | Reconstruction | Reactions | Contacts | Surface,
    rod: Rod,
    trails: Sequence[int] | None,
    rods: int,
    *,
    directions: bool,
) -> Shown:
    """What a scene holds of a result.

    Raises
    ------
    ValueError
        If that is nothing, there are no such trails, or `rods` is negative.
    """
    if rods < 0:
        raise ValueError(f"rods = {rods}; allowed is 0 or more")
    if isinstance(what, Surface):
        return Shown(np.zeros((0, 1, 3)))
    if isinstance(what, Contacts):
        contacts = known(what, np.ones(what.point.shape[:-1], dtype=bool))
        if not len(contacts.point):
            raise no_contact(np.asarray(what.status if what.status is not None else []), "rows")
        every = max(1, len(contacts.point) // max(rods, 1))
        arrows = _directions(contacts[::every], rod) if directions else ()
        return Shown(np.zeros((0, 1, 3)), contacts, arrows=arrows)
    trail = what.trail if isinstance(what, Scan | Reactions) else what.reactions.trail
    chosen = _chosen(trail, trails)
    path = trail.position[chosen].reshape(-1, trail.count, 3)
    if isinstance(what, Reactions):
        return _forces(what, rod, path, _spread(chosen & np.isfinite(what.force).all(-1), rods))
    contacts = known(what.contacts, chosen & what.in_contact)
    usable = chosen & np.isfinite(what.energy)
    if isinstance(what, Reconstruction):
        usable &= what.in_contact & np.isfinite(what.point).all(axis=-1)
    drawn = _spread(usable, rods)
    if not len(contacts.point) and not drawn.any():
        raise no_contact(what.status[chosen], "rows")
    arrows = _directions(what.contacts[drawn & what.in_contact], rod) if directions else ()
    listed = tuple(what.events) if isinstance(what, Scan) else ()
    kept = tuple(event for event in listed if trails is None or event.trail in trails)
    lost = what.status[chosen & ~what.in_contact & (what.status != Status.OK)]
    return Shown(path, contacts, lines(what, drawn), arrows, kept, lost)


def _chosen(trail: Trail, trails: Sequence[int] | None) -> Bool[np.ndarray, "*trail n"]:
    """The rows of some trails."""
    count = 1 if len(trail.shape) == 1 else trail.shape[0]
    if trails is None:
        return np.ones(trail.shape, dtype=bool)
    if not len(trails) or not set(trails) <= set(range(count)):
        raise ValueError(f"trails = {list(trails)}; allowed are some of 0 to {count - 1}")
    chosen = np.zeros((count, trail.count), dtype=bool)
    chosen[list(trails)] = True
    return chosen.reshape(trail.shape)


def _spread(usable: Bool[np.ndarray, "*trail n"], rods: int) -> Bool[np.ndarray, "*trail n"]:
    """About as many rows of each trail as rods are wanted, evenly among the usable ones."""
    drawn = np.zeros_like(usable)
    rows = drawn.reshape(-1, usable.shape[-1])
    for row, known_ones in zip(rows, usable.reshape(rows.shape), strict=True):
        numbers = np.flatnonzero(known_ones)
        row[numbers[:: max(1, len(numbers) // max(rods, 1))]] = rods > 0
    return drawn


def _forces(
    what: Reactions,
    rod: Rod,
    path: Float[np.ndarray, "trail n 3"],
    drawn: Bool[np.ndarray, "*trail n"],
) -> Shown:
    """Forces on the free rod."""
    if not np.isfinite(what.force).all(axis=-1).any():
        raise ValueError(
            f"nothing to draw: none of {what.trail.position[..., 0].size} forces is known"
        )
    largest = float(np.nanmax(np.linalg.norm(what.force, axis=-1)))
    clamps = what.trail.position[drawn]
    free = free_lines(rod, what.trail, 2 if rod.plain else _SAMPLES, drawn)
    pieces = np.stack([free[:, :-1], free[:, 1:]], axis=2).reshape(-1, 2, 3)
    unbent = space.Segments(pieces, np.full(len(pieces), FREE))
    # A sensor at rest reads exactly zero only in a simulation.
    forces = -_ARROW * rod.length * what.force[drawn] / max(largest, np.finfo(float).tiny)
    name = f"force on the clamp, up to {largest:.3g} {'N' if rod.units == 'SI' else 'EI/L²'}"
    return Shown(path, rods=unbent, arrows=(space.Arrows(clamps, forces, space.FORCE, name),))


def known(contacts: Contacts, rows: Bool[np.ndarray, "*rows"]) -> Contacts:
    """Some contacts, as far as their point is known, in one row each."""
    return contacts[rows & np.isfinite(contacts.point).all(axis=-1)]


def _directions(contacts: Contacts, rod: Rod) -> tuple[space.Arrows, ...]:
    """Normals, and forces where friction lets them differ."""
    normal, force = contacts.normal, contacts.force_direction
    pairs = [(normal, space.NORMAL, "normal")]
    if force is not None and not np.allclose(force, normal, equal_nan=True):
        pairs.append((force, space.FORCE, "force on the rod"))
    return tuple(
        space.Arrows(contacts.point, _ARROW * rod.length * vectors, colour, name)
        for vectors, colour, name in pairs
    )


def lines(what: Scan | Reconstruction, rows: Bool[np.ndarray, "*trail n"]) -> space.Segments:
    """Elastic lines at some rows."""
    ends, colours = [np.zeros((0, 2, 3))], [np.zeros(0, dtype="U7")]
    for _, rod in drawn_rods(what, rows, _SAMPLES):
        ends.append(np.stack([rod.line[:-1], rod.line[1:]], axis=1))
        colours.append(np.where(rod.bent, rod.paint, rod.rest))
    return space.Segments(np.concatenate(ends), np.concatenate(colours))
