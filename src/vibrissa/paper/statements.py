"""The statements of the paper's section III, each with the value measured here."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float

from vibrissa.contacts import ContactKind
from vibrissa.forward import EventKind, Scan
from vibrissa.inverse import Reconstruction
from vibrissa.paper.case import PLANE, Y0

_ZERO = 1e-9


class Statement(NamedTuple):
    """One statement, what was measured, and whether it holds."""

    statement: str
    measured: str
    holds: bool


_Rows = Iterator[tuple[str, str, bool]]


def statements(scan: Scan, plane: Scan, found: Reconstruction) -> list[Statement]:
    """Check every statement on the ten trails y0 ≠ 0, and on the plane case y0 = 0.

    Parameters
    ----------
    scan, found
        Of the eleven trails, and reconstructed from its reactions.
    plane
        The trail y0 = 0, through its snap-off.
    """
    rows = [lane for lane in range(len(Y0)) if lane != PLANE]
    parts = (
        _reactions(scan, rows),
        _phases(scan, rows),
        _sequences(found, scan, rows),
        _plane(plane),
        _inverse(scan, found, rows),
    )
    return [
        Statement(text, measured, bool(holds)) for part in parts for text, measured, holds in part
    ]


def _reactions(scan: Scan, rows: list[int]) -> _Rows:
    force, moment, contact = (
        part[rows] for part in (scan.reactions.force, scan.reactions.moment, scan.in_contact)
    )
    values = np.concatenate([force, moment], axis=-1)
    fx, fy, fz, mx, my, mz = np.moveaxis(values, -1, 0)
    x0, y0, _ = np.moveaxis(scan.trail.position[rows], -1, 0)
    least, text = np.min(fz[contact]), "changes its sign at x0 = 0, from − to + along the sweep"
    for statement, value, like, more in (
        (
            "f0z is positive throughout: the object presses the rod towards its clamp",
            fz,
            np.ones_like(fz),
            f"; least {least:.3g} EI/L²",
        ),
        (f"f0x {text}", fx, -x0, ""),
        ("f0y has the sign of −y0", fy, -y0, ""),
        ("m0x has the sign of y0", mx, y0, ""),
        (f"m0y {text}", my, -x0, ""),
    ):
        wrong = contact & (np.abs(like) > _ZERO) & (np.sign(value) != np.sign(like))
        measured = f"{wrong.sum()} of {contact.sum()} otherwise{more}"
        yield statement, measured, not wrong.any()
    twist = np.abs(mz[contact]).max()
    yield "m0z = 0: the rod is not twisted", f"largest |m0z| {twist:.1e} EI/L", twist < _ZERO

    # Mirror x → −x reverses the positions, y → −y the trails; moments are axial vectors.
    for signs, mirrored, text in (
        ([-1, 1, 1, 1, -1, -1], values[:, ::-1], "x0 = 0: f0x and m0y odd, f0y, f0z and m0x even"),
        ([1, -1, 1, -1, 1, -1], values[::-1], "y0 = 0: f0y and m0x odd, f0x, f0z and m0y even"),
    ):
        error = np.abs(signs * mirrored - values).max()
        measured = f"largest deviation {error:.1e}"
        yield f"The reactions are symmetric about {text}", measured, error < _ZERO

    for name, vectors, unit in (("force", force, "EI/L²"), ("moment", moment, "EI/L")):
        largest = np.linalg.norm(vectors, axis=-1).max(axis=1)
        by_distance = pd.Series(largest).groupby(np.abs(Y0[rows])).max()
        shown = ", ".join(f"{value:.3f}" for value in by_distance)
        yield (
            f"The support {name} is largest for small |y0|",
            f"largest at |y0| = 0.1 … 0.5: {shown} {unit}",
            np.diff(by_distance).max() < 0,
        )


def _phases(scan: Scan, rows: list[int]) -> _Rows:
    tangential = (scan.kind[rows] == ContactKind.TANGENTIAL).any(axis=1)
    distances = np.abs(Y0[rows])
    touching = np.unique(distances[tangential]).tolist()
    tip_only = np.setdiff1d(distances, touching).tolist()
    yield (
        "For large |y0| the rod touches with its tip only",
        f"tip only on |y0| = {', '.join(map(str, tip_only))}",
        tip_only == [0.4, 0.5],
    )
    shortest = np.nanmin(scan.arc_length[rows][tangential])
    yield (
        "For small |y0| tip contact turns into tangential contact and back",
        f"tangential on |y0| = {', '.join(map(str, touching))}; least s1 = {shortest:.5f} L",
        touching == [0.1, 0.2, 0.3],
    )
    events = [event for event in scan.events if event.trail in rows]
    snaps = sum(event.kind == EventKind.SNAP for event in events)
    met, released = (
        {event.trail: event.clamp[0] for event in events if event.kind == kind}
        for kind in (EventKind.FIRST_CONTACT, EventKind.DETACH)
    )
    yield (
        "For y0 ≠ 0 there is no snap-off: the force falls to zero at detachment",
        f"{snaps} snaps, {len(released)} smooth detachments",
        snaps == 0 and len(released) == len(rows),
    )
    mirrored = max((abs(x + met[lane]) for lane, x in released.items()), default=np.inf)
    yield (
        "Detachment mirrors first contact",
        f"largest difference {mirrored:.1e} L",
        mirrored < _ZERO,
    )


def _sequences(found: Reconstruction, scan: Scan, rows: list[int]) -> _Rows:
    kinks: list[float] = []
    smooth: list[float] = []
    spacing: list[float] = []
    for lane in rows:
        touching = scan.in_contact[lane]
        steps = np.diff(found.point[lane][touching], axis=0)
        changes = np.flatnonzero(np.diff(scan.kind[lane][touching]))
        lengths = np.linalg.norm(steps, axis=1)
        along = steps / lengths[:, None]
        spacing.extend(lengths)
        # The step across a change belongs to neither phase: compare those before and after it.
        kinks.extend(_angles(along[changes - 1], along[changes + 1]))
        turns = _angles(along[:-1], along[1:])
        smooth.extend(np.delete(turns, changes[:, None] + np.arange(-2, 2)))
    yield (
        "The sequences have edges where the phase changes",
        f"turn of {min(kinks):.1f}° to {max(kinks):.1f}° at {len(kinks)} phase changes, at most "
        f"{max(smooth):.1f}° a step elsewhere",
        min(kinks) > 2 * max(smooth),
    )
    ratio = np.divide(*np.percentile(spacing, [95, 5]))
    yield (
        "Equal steps of the clamp give contacts of uneven density",
        f"spacing varies by a factor of {ratio:.1f} (5th to 95th percentile)",
        ratio > 2,
    )
    x, y = np.abs(np.moveaxis(found.point[rows], -1, 0)[:2])
    gap = np.min(y[x < 0.3])
    yield (
        "A region around the vertex is not reached",
        f"no contact with |x| < 0.3 L comes nearer to the plane y = 0 than {gap:.3f} L",
        gap > 0.3,
    )


def _plane(plane: Scan) -> _Rows:
    place = {event.kind: (event.clamp[0], event.point[0]) for event in plane.events}
    (snap, _), (lateral, contact) = (
        place.get(kind, (np.nan, np.nan))
        for kind in (EventKind.SNAP, EventKind.LATERAL_INSTABILITY)
    )
    force = np.nanmax(np.linalg.norm(plane.reactions.force, axis=-1))
    yield (
        "On y0 = 0 the rod stays in the plane and snaps off",
        f"snap at x0 = {snap:.8f} L with f up to {force:.2f} EI/L²",
        abs(snap + 1.34212374) < 1e-8,
    )
    yield (
        "(beyond the paper) that plane branch is laterally unstable",
        f"from x0 = {lateral:.12f} L on, contact at x = {contact:.12f} L",
        abs(lateral - 0.474512782442167) < _ZERO,
    )


def _inverse(scan: Scan, found: Reconstruction, rows: list[int]) -> _Rows:
    error = np.nanmax(np.linalg.norm(found.point[rows] - scan.point[rows], axis=-1))
    total, got = (part.in_contact[rows].sum() for part in (scan, found))
    yield (
        "The contact points follow from the reactions alone",
        f"{got} of {total} found, largest error {error:.1e} L",
        error < 1e-10 and got == total,
    )


def _angles(
    first: Float[np.ndarray, "k 3"], second: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k"]:
    """Angles [°] between unit vectors."""
    return np.degrees(np.arccos(np.clip(np.sum(first * second, axis=1), -1, 1)))
