"""The statements of the paper's section III, each with the figure measured here."""

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import ContactKind
from vibrissa.forward import EventKind, Scan
from vibrissa.inverse import Reconstruction
from vibrissa.paper.case import PLANE, Y0

_ZERO = 1e-9


class Statement(NamedTuple):
    """One statement, what was measured, and whether it holds."""

    text: str
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
        The trail y0 = 0, on to its snap-off.
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
    x0, y0 = np.moveaxis(scan.trail.position[rows], -1, 0)[:2]
    inner = contact & (np.abs(x0) > _ZERO)
    least = float(np.min(np.where(contact, force[..., 2], np.inf)))
    sign, text = np.sign, "changes its sign at x0 = 0, from − to + along the sweep"
    for statement, wrong, more in (
        (
            "f0z is positive throughout: the object presses the rod towards its clamp",
            contact & (force[..., 2] <= 0),
            f"; least {least:.3g} EI/L²",
        ),
        (f"f0x {text}", inner & (sign(force[..., 0]) != -sign(x0)), ""),
        ("f0y has the sign of −y0", contact & (sign(force[..., 1]) != -sign(y0)), ""),
        ("m0x has the sign of y0", contact & (sign(moment[..., 0]) != sign(y0)), ""),
        (f"m0y {text}", inner & (sign(moment[..., 1]) != -sign(x0)), ""),
    ):
        measured = f"{wrong.sum()} of {contact.sum()} otherwise{more}"
        yield statement, measured, not wrong.any()
    twist = float(np.max(np.abs(np.where(contact, moment[..., 2], 0))))
    yield "m0z = 0: the rod is not twisted", f"largest |m0z| {twist:.1e} EI/L", twist < _ZERO

    values = np.concatenate([force, moment], axis=-1)
    # Mirror x → −x reverses the positions, y → −y the trails; moments are axial vectors.
    for mirrored, text in (
        (
            np.array([-1, 1, 1, 1, -1, -1]) * values[:, ::-1],
            "x0 = 0: f0x and m0y odd, f0y, f0z and m0x even",
        ),
        (
            np.array([1, -1, 1, -1, 1, -1]) * values[::-1],
            "y0 = 0: f0y and m0x odd, f0x, f0z and m0y even",
        ),
    ):
        error = float(np.abs(mirrored - values).max())
        measured = f"largest deviation {error:.1e}"
        yield f"The reactions are symmetric about {text}", measured, error < _ZERO

    distances = np.abs(Y0[rows])
    for name, vectors, unit in (("force", force, "EI/L²"), ("moment", moment, "EI/L")):
        largest = np.linalg.norm(vectors, axis=-1).max(axis=1)
        by_distance = [float(largest[distances == y].max()) for y in np.unique(distances)]
        shown = ", ".join(f"{value:.3f}" for value in by_distance)
        yield (
            f"The support {name} is largest for small |y0|",
            f"largest at |y0| = 0.1 … 0.5: {shown} {unit}",
            all(a > b for a, b in pairwise(by_distance)),
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
    shortest = float(np.nanmin(scan.arc_length[rows][tangential]))
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
    mirrored = max((abs(float(x + met[lane])) for lane, x in released.items()), default=np.inf)
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
        steps, changes = _steps(found.point[lane], scan.kind[lane])
        spacing += np.linalg.norm(steps, axis=1).tolist()
        # The step across a change is neither here nor there: the one before it and the one behind
        # it are compared.
        kinks += _turns(steps[changes - 1], steps[changes + 1]).tolist()
        turns = _turns(steps[:-1], steps[1:])
        elsewhere = np.setdiff1d(np.arange(len(turns)), changes[:, None] + np.arange(-2, 2))
        smooth += turns[elsewhere].tolist()
    yield (
        "The sequences have edges where the phase changes",
        f"turn of {min(kinks):.1f}° to {max(kinks):.1f}° at {len(kinks)} phase changes, at most "
        f"{max(smooth):.1f}° a step elsewhere",
        min(kinks) > 2 * max(smooth),
    )
    ratio = float(np.percentile(spacing, 95) / np.percentile(spacing, 5))
    yield (
        "Equal steps of the clamp give contacts of uneven density",
        f"spacing varies by a factor of {ratio:.1f} (5th to 95th percentile)",
        ratio > 2,
    )
    x, y = np.abs(np.moveaxis(found.point[rows], -1, 0)[:2])
    gap = float(np.nanmin(np.where(x < 0.3, y, np.nan)))
    yield (
        "A region around the vertex is not reached",
        f"no contact with |x| < 0.3 L comes nearer to the plane y = 0 than {gap:.3f} L",
        gap > 0.3,
    )


def _plane(plane: Scan) -> _Rows:
    at = {event.kind: event for event in plane.events}
    snap, lateral = at.get(EventKind.SNAP), at.get(EventKind.LATERAL_INSTABILITY)
    force = float(np.nanmax(np.linalg.norm(plane.reactions.force, axis=-1)))
    yield (
        "On y0 = 0 the rod stays in the plane and snaps off",
        "no snap"
        if snap is None
        else f"snap at x0 = {snap.clamp[0]:.8f} L with f up to {force:.2f} EI/L²",
        snap is not None and abs(float(snap.clamp[0]) + 1.34212374) < 1e-8,
    )
    yield (
        "(beyond the paper) that plane branch is laterally unstable",
        "no instability"
        if lateral is None
        else f"from x0 = {lateral.clamp[0]:.12f} L on, contact at x = {lateral.point[0]:.12f} L",
        lateral is not None and abs(float(lateral.clamp[0]) - 0.474512782442167) < _ZERO,
    )


def _inverse(scan: Scan, found: Reconstruction, rows: list[int]) -> _Rows:
    error = float(np.nanmax(np.linalg.norm(found.point[rows] - scan.point[rows], axis=-1)))
    total, got = int(scan.in_contact[rows].sum()), int(found.in_contact[rows].sum())
    yield (
        "The contact points follow from the reactions alone",
        f"{got} of {total} found, largest error {error:.1e} L",
        error < 1e-10 and got == total,
    )


def _steps(
    point: Float[np.ndarray, "n 3"], kind: np.ndarray
) -> tuple[Float[np.ndarray, "k 3"], np.ndarray]:
    """Steps from contact to contact, and the numbers of those across a change of phase."""
    touching = kind[kind != ContactKind.NONE]
    return (
        np.diff(point[np.isfinite(point[:, 0])], axis=0),
        np.flatnonzero(touching[1:] != touching[:-1]),
    )


def _turns(
    before: Float[np.ndarray, "k 3"], after: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "k"]:
    """Angles [°] between steps."""
    lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
    return np.degrees(np.arccos(np.clip(np.sum(before * after, axis=1) / lengths, -1, 1)))
