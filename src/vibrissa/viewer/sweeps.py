"""Scans, reconstructions, contacts, shapes and setups as contents of a page."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from vibrissa.contacts import ContactKind, Contacts, Status
from vibrissa.drawing import BEHIND, Swept, drawn_rods, length_factor, length_unit
from vibrissa.forward import Scan, scan
from vibrissa.geometry.rotation import multiplied, rotation_matrices
from vibrissa.io import Case, Setup
from vibrissa.io.setup import ConstantPoseTable
from vibrissa.mechanics.shape import free_lines
from vibrissa.rod import Rod
from vibrissa.shape import ShapeMesh
from vibrissa.surfaces import Surface
from vibrissa.surfaces.outline import box_of, outline
from vibrissa.trail import Trail
from vibrissa.viewer.content import (
    MILLIMETRES,
    SAMPLES,
    UNKNOWN,
    Content,
    Fitted,
    Instant,
    Pose,
    Rows,
    in_millimetres,
)

_INSTANTS = 240
"""Positions of the time slider: as many as it has pixels."""
_MOST = 20_000
"""Contacts shown: more are a blot, and a browser slows down."""
WHOLE = 3.0
"""Rod lengths within which an object is shown whole, where no contact says which part matters."""
_NOTHING = np.zeros((0, 3, 3))


def of_sweep(what: Swept, surface: Surface | None) -> Content:
    """A scan or a reconstruction, with the object if it is known: several trails run side by side.

    Raises
    ------
    ValueError
        If no position holds a rod or a contact; the message counts them by status.
    """
    rod, trail = what.rod, what.reactions.trail
    factor, position = length_factor(rod), trail.position.reshape(-1, trail.count, 3)
    contacts = Contacts.of(what, what.reactions.time)
    force = np.linalg.norm(what.reactions.force, axis=-1)
    rows, row_of, notes = contact_rows(contacts, force, factor)
    drawn = rods_known(what)
    if not drawn.any():
        codes, counts = np.unique(what.status, return_counts=True)
        said = [f"{n} {Status(code).name}" for code, n in zip(codes, counts, strict=True)]
        raise ValueError(f"nothing to show: {', '.join(said)}; no rod is solved, no contact found")
    chosen = np.unique(np.linspace(0, trail.count - 1, min(trail.count, _INSTANTS)).astype(int))
    labels = _labels(what.reactions.time, trail.count, chosen)
    instants = tuple(
        Instant(label, rods, rows[own])
        for label, rods, own in zip(
            labels, rods_at(what, drawn, chosen), _since(row_of, chosen), strict=True
        )
    )
    around = rows.point / factor if len(rows) else position.reshape(-1, 3)
    return Content(
        length_unit(rod),
        "N" if rod.units == "SI" else "EI/L²",
        factor * rod.length,
        triangles_of(surface, around, rod),
        tuple(factor * path for path in position),
        instants=instants,
        notes=notes,
    )


def of_contacts(contacts: Contacts, surface: Surface | None, rod: Rod | None) -> Content:
    """Contacts alone, in the order of their rows; in the rod's unit if there is one.

    Raises
    ------
    ValueError
        If none has a finite point.
    """
    factor = 1.0 if rod is None else length_factor(rod)
    rows, row_of, notes = contact_rows(contacts, np.full(contacts.point.shape[:-1], np.nan), factor)
    if not len(rows):
        raise ValueError(f"nothing to show: none of {contacts.point.shape[:-1]} rows is a contact")
    count = int(row_of.max()) + 1
    chosen = np.unique(np.linspace(0, count - 1, min(count, _INSTANTS)).astype(int))
    extent = float(np.linalg.norm(np.ptp(rows.point, axis=0))) or 1.0
    time = contacts.time if contacts.point.ndim == 2 else None
    labels = _labels(time, count, chosen)
    instants = tuple(
        Instant(label, {}, rows[own])
        for label, own in zip(labels, _since(row_of, chosen), strict=True)
    )
    return Content(
        UNKNOWN if rod is None else length_unit(rod),
        "",
        extent / 2 if rod is None else factor * rod.length,
        np.zeros((0, 3, 3)) if rod is None else triangles_of(surface, rows.point / factor, rod),
        instants=instants,
        notes=notes,
    )


def of_shape(
    mesh: ShapeMesh, contacts: Contacts, outlier: Bool[np.ndarray, "given"], rod: Rod | None
) -> Content:
    """A fitted surface and its contacts, in metres unless a rod is in the model's units.

    Raises
    ------
    ValueError
        If the mesh has no triangle.
    """
    content = of_contacts(contacts, None, rod)
    if rod is None:
        content = in_millimetres(content)
    factor = MILLIMETRES if rod is None else length_factor(rod)
    points = contacts.point.reshape(-1, 3)[outlier]
    return replace(content, fitted=(fitted_of(mesh, points, factor),))


def fitted_of(mesh: ShapeMesh, outlier: Float[np.ndarray, "o 3"], factor: float) -> Fitted:
    """A mesh in the unit shown.

    Raises
    ------
    ValueError
        If it has no triangle.
    """
    if not len(mesh.faces):
        raise ValueError("mesh has no triangle; allowed is a surface that was touched")
    return Fitted(
        factor * mesh.vertices, mesh.faces, mesh.normal, factor * mesh.deviation, factor * outlier
    )


def of_case(case: Case) -> Content:
    """The scan of a case."""
    found = scan(
        case.rod,
        case.surface,
        case.trail,
        friction=case.friction,
        finite_radius=case.finite_radius,
    )
    return of_sweep(found, case.surface)


def of_setup(setup: Setup) -> Content:
    """The rod at its sensor and the object, where the setup says they are.

    A sensor whose pose is not constant is drawn at the origin, or, if there is an object, not at
    all: where it is relative to that is not known.
    """
    rod, surface, factor = setup.rod, setup.surface, length_factor(setup.rod)
    stated = setup.pose if isinstance(setup.pose, ConstantPoseTable) else None
    place = stated or ConstantPoseTable(kind="constant")
    sensor = np.array(place.position), np.array(place.orientation)
    clamp = (
        sensor[0] + rotation_matrices(sensor[1]) @ setup.sensor.clamp_position,
        multiplied(sensor[1], setup.sensor.clamp_orientation),
    )
    pose = Trail(clamp[0][None], clamp[1][None])
    (line,) = factor * free_lines(rod, pose, 2 if rod.plain else SAMPLES)
    pieces = np.stack([line[:-1], line[1:]], axis=1)
    rod_only = Instant("as mounted", {BEHIND: pieces}, Rows.none())
    poses = (
        Pose("sensor", factor * sensor[0], sensor[1]),
        Pose("clamp", factor * clamp[0], clamp[1]),
    )
    known = stated is not None or surface is None
    near = clamp[0][None] if surface is None else surface.nearest(clamp[0])[None]
    return Content(
        length_unit(rod),
        "N",
        factor * rod.length,
        triangles_of(surface, near, rod, WHOLE),
        poses=poses if known else (),
        instants=(rod_only,) if known else (),
        notes=() if stated else ("The setup does not say where the sensor is in the world.",),
    )


def contact_rows(
    contacts: Contacts, force: Float[np.ndarray, "*rows"], factor: float
) -> tuple[Rows, Int[np.ndarray, "c"], tuple[str, ...]]:
    """Contacts with a point, in the unit shown; the position of each along its sweep, from 0; and
    what is left out.
    """
    shape = contacts.point.shape[:-1]
    there = np.isfinite(contacts.point).all(axis=-1)
    if contacts.kind is not None:
        there &= contacts.kind != ContactKind.NONE
    along = np.broadcast_to(np.arange(shape[-1]), shape)
    if len(shape) == 1 and contacts.sweep is not None:
        along = np.zeros(shape, dtype=int)
        for sweep in np.unique(contacts.sweep):
            along[contacts.sweep == sweep] = np.arange((contacts.sweep == sweep).sum())
    order = np.argsort(along[there], kind="stable")
    step = -(-len(order) // _MOST)
    order = order[:: max(step, 1)]

    def chosen(values: np.ndarray | None, otherwise: float, *own: int) -> np.ndarray:
        whole = np.full((*shape, *own), otherwise) if values is None else values
        return np.asarray(whole[there][order])

    rows = Rows(
        factor * chosen(contacts.point, np.nan, 3),
        chosen(contacts.normal, np.nan, 3),
        chosen(contacts.kind, ContactKind.NONE).astype(int),
        chosen(contacts.status, Status.OK).astype(int),
        factor * chosen(contacts.arc_length, np.nan),
        chosen(contacts.time, np.nan),
        chosen(force, np.nan),
        factor**2 * chosen(contacts.covariance, np.nan, 3, 3),
    )
    notes = (f"One contact in {step} is shown.",) if step > 1 else ()
    return rows, along[there][order], notes


def _since(
    row_of: Int[np.ndarray, "c"], chosen: Int[np.ndarray, "k"]
) -> Iterator[Int[np.ndarray, "own"]]:
    """For each chosen position, the contacts that came since the one before."""
    at = np.searchsorted(chosen, row_of)
    for number in range(len(chosen)):
        yield np.flatnonzero(at == number)


def rods_known(what: Swept) -> Bool[np.ndarray, "*trail n"]:
    """Rows whose rod can be drawn: it is free where a reconstruction finds no contact."""
    solved = np.isfinite(what.energy)
    free = ~what.in_contact
    if isinstance(what, Scan):
        return np.asarray(solved)
    return np.asarray(np.where(free, ~np.isnan(what.reactions.force).any(axis=-1), solved))


def rods_at(
    what: Swept, known: Bool[np.ndarray, "*trail n"], chosen: Int[np.ndarray, "k"]
) -> list[dict[str, Float[np.ndarray, "pieces 2 3"]]]:
    """Pieces of the rods of all trails at the chosen positions, by colour."""
    rows, factor = np.zeros(known.shape, dtype=bool), length_factor(what.rod)
    rows[..., chosen] = known[..., chosen]
    place = {row: number for number, row in enumerate(chosen.tolist())}
    parts: list[dict[str, list[np.ndarray]]] = [{} for _ in place]
    for at, rod in drawn_rods(what, rows, SAMPLES):
        pieces = factor * np.stack([rod.line[:-1], rod.line[1:]], axis=1)
        here = parts[place[int(at[-1])]]
        here.setdefault(rod.paint, []).append(pieces[rod.bent])
        here.setdefault(rod.rest, []).append(pieces[~rod.bent])
    return [{colour: np.concatenate(own) for colour, own in part.items()} for part in parts]


def _labels(
    time: Float[np.ndarray, "*trail n"] | None, count: int, chosen: Int[np.ndarray, "k"]
) -> list[str]:
    """What the slider says at the chosen positions: time since the first, or the number."""
    if time is None or time.ndim > 1 or np.isnan(time).any():
        return [f"position {row + 1} of {count}" for row in chosen.tolist()]
    return [f"{moment - time[0]:.2f} s" for moment in time[chosen].tolist()]


def triangles_of(
    surface: Surface | None, around: Float[np.ndarray, "n 3"], rod: Rod, reach: float = 1.0
) -> Float[np.ndarray, "f 3 3"]:
    """The part of the object within some rod lengths of these points, as shown."""
    box = (
        None
        if surface is None
        else box_of(surface, around, reach * rod.length, reach / 8 * rod.length)
    )
    if surface is None or box is None:
        return _NOTHING
    return length_factor(rod) * outline(surface, *box)
