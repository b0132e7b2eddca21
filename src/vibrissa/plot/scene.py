"""A sweep in space: object, rods, contacts and events."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from mpl_toolkits.mplot3d import Axes3D

from vibrissa.contacts import Contacts
from vibrissa.drawing import FREE, drawn_rods
from vibrissa.forward import Scan
from vibrissa.forward.events import Event
from vibrissa.inverse import Reconstruction
from vibrissa.plot import space
from vibrissa.plot.style import no_contact
from vibrissa.reactions import Reactions
from vibrissa.rod import Rod
from vibrissa.surfaces import Surface
from vibrissa.surfaces.outline import box_of, outline

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
    view: tuple[float, float] = (15.0, -55.0),
    axes: Axes3D | None = None,
) -> Axes3D:
    """Object, rods, contact points with their uncertainty, trails and events.

    Rods are red in tip contact, blue in tangential contact, black where they are straight, grey
    without contact, and faint behind the object. Contacts whose status is not OK are crosses. Known
    uncertainties are drawn as the principal axes of 95 % ellipsoids. A recording is shown as forces
    on the straight rod.

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
        default what surrounds the contacts, or lies within two rod lengths of the origin.
    view
        Elevation and azimuth of the eye [°].
    axes
        Axes in space to draw in; by default those of a new figure.

    Returns
    -------
    Axes3D
        Axes in millimetres, or in rod lengths for a rod in model units.

    Raises
    ------
    ValueError
        If the rod is needed and not given, or there is nothing to draw.
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
    chosen = None if trails is None else list(trails)
    shown = shown_of(what, rod, chosen, rods, directions=directions)
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
    view: tuple[float, float],
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
    edges = np.zeros(3), np.zeros(3)
    if box is not None:
        edges = np.asarray(box[0], dtype=float), np.asarray(box[1], dtype=float)
    elif surface is not None and len(around):
        edges = box_of(surface, touched if len(touched) else around, rod.length)
    elif surface is not None:
        edges = box_of(surface, np.zeros((1, 3)), 2 * rod.length)
    stage = space.Stage.at(view, rod, surface, edges, axes)
    if surface is not None:
        around = np.vstack([around, stage.draw_object(outline(surface, *edges))])
    stage.draw_paths(shown.path)
    return stage, around


def draw_moving(stage: space.Stage, shown: Shown) -> None:
    """Contacts and rods."""
    if shown.contacts is not None:
        stage.draw_contacts(shown.contacts)
    stage.draw_rods(shown.rods)


def shown_of(
    what: Scan | Reconstruction | Reactions | Contacts | Surface,
    rod: Rod,
    trails: list[int] | None,
    rods: int,
    *,
    directions: bool,
) -> Shown:
    """What a scene holds of a result.

    Raises
    ------
    ValueError
        If that is nothing.
    """
    if isinstance(what, Surface):
        return Shown(np.zeros((0, 1, 3)))
    if isinstance(what, Contacts):
        contacts = known(what, np.ones(what.point.shape[:-1], dtype=bool))
        every = max(1, len(contacts.point) // max(rods, 1))
        arrows = _directions(contacts[::every], rod) if directions else ()
        return Shown(np.zeros((0, 1, 3)), contacts, arrows=arrows)
    trail = what.trail if isinstance(what, Scan | Reactions) else what.reactions.trail
    chosen = np.zeros(trail.shape, dtype=bool)
    chosen[slice(None) if trails is None or chosen.ndim == 1 else trails] = True
    drawn = np.zeros_like(chosen)
    drawn[..., :: max(1, trail.count // max(rods, 1))] = rods > 0
    drawn &= chosen
    path = trail.position[chosen].reshape(-1, trail.count, 3)
    if isinstance(what, Reactions):
        largest = np.nanmax(np.linalg.norm(what.force[chosen], axis=-1))
        tips = trail.position[drawn] + rod.length * trail.axis[drawn]
        straight = space.Segments(
            np.stack([trail.position[drawn], tips], axis=1), np.full(len(tips), FREE)
        )
        forces = -_ARROW * rod.length * what.force[drawn] / largest
        name = f"force on the clamp, up to {largest:.3g} {'N' if rod.units == 'SI' else 'EI/L²'}"
        pushes = space.Arrows(trail.position[drawn], forces, space.FORCE, name)
        return Shown(path, rods=straight, arrows=(pushes,))
    contacts = known(what.contacts, chosen & what.in_contact)
    drawn &= np.isfinite(what.energy)
    if isinstance(what, Reconstruction):
        drawn &= what.in_contact & np.isfinite(what.point).all(axis=-1)
    if not len(contacts.point) and not drawn.any():
        raise no_contact(what.status[chosen], "rows")
    arrows = _directions(what.contacts[drawn & what.in_contact], rod) if directions else ()
    listed = tuple(what.events) if isinstance(what, Scan) else ()
    kept = tuple(event for event in listed if trails is None or event.trail in trails)
    return Shown(path, contacts, lines(what, drawn), arrows, kept)


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
