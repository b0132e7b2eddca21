"""The statements of the paper's section III, each with the figure measured here."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from vibrissa.contacts import ContactKind
from vibrissa.forward import EventKind, Scan
from vibrissa.inverse import Reconstruction
from vibrissa.paper.case import PLANE, Y0

_ZERO = 1e-9


@dataclass(frozen=True)
class Statement:
    """One statement, what was measured, and whether it holds."""

    text: str
    measured: str
    holds: bool


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
    return [
        *_signs(scan, rows),
        *_symmetries(scan, rows),
        *_sizes(scan, rows),
        *_phases(scan, rows),
        *_sequences(found, scan, rows),
        *_plane(plane),
        _inverse(scan, found, rows),
    ]


def _signs(scan: Scan, rows: list[int]) -> list[Statement]:
    contact = scan.in_contact[rows]
    force, moment = scan.reactions.force[rows], scan.reactions.moment[rows]
    x0, y0 = scan.trail.position[rows][..., 0], scan.trail.position[rows][..., 1]
    inner = contact & (np.abs(x0) > _ZERO)
    wrong = [
        int(np.sum(contact & (force[..., 2] <= 0))),
        int(np.sum(inner & (np.sign(force[..., 0]) != -np.sign(x0)))),
        int(np.sum(contact & (np.sign(force[..., 1]) != -np.sign(y0)))),
        int(np.sum(contact & (np.sign(moment[..., 0]) != np.sign(y0)))),
        int(np.sum(inner & (np.sign(moment[..., 1]) != -np.sign(x0)))),
    ]
    total = int(contact.sum())
    least = float(np.min(np.where(contact, force[..., 2], np.inf)))
    twist = float(np.max(np.abs(np.where(contact, moment[..., 2], 0))))
    return [
        Statement(
            "f0z is positive throughout: the object presses the rod towards its clamp",
            f"{wrong[0]} of {total} otherwise; least {least:.3g} EI/L²",
            wrong[0] == 0,
        ),
        Statement(
            "f0x changes its sign at x0 = 0, from − to + along the sweep",
            f"{wrong[1]} of {total} otherwise",
            wrong[1] == 0,
        ),
        Statement("f0y has the sign of −y0", f"{wrong[2]} of {total} otherwise", wrong[2] == 0),
        Statement("m0x has the sign of y0", f"{wrong[3]} of {total} otherwise", wrong[3] == 0),
        Statement(
            "m0y changes its sign at x0 = 0, from − to + along the sweep",
            f"{wrong[4]} of {total} otherwise",
            wrong[4] == 0,
        ),
        Statement(
            "m0z = 0: the rod is not twisted", f"largest |m0z| {twist:.1e} EI/L", twist < _ZERO
        ),
    ]


def _symmetries(scan: Scan, rows: list[int]) -> list[Statement]:
    values = np.concatenate([scan.reactions.force, scan.reactions.moment], axis=-1)[rows]
    # Mirror x → −x reverses the positions, y → −y the trails; moments are axial vectors.
    along = np.array([-1, 1, 1, 1, -1, -1]) * values[:, ::-1]
    across = np.array([1, -1, 1, -1, 1, -1]) * values[::-1]
    results = []
    for mirrored, text in (
        (along, "symmetric about x0 = 0: f0x and m0y odd, f0y, f0z and m0x even"),
        (across, "symmetric about y0 = 0: f0y and m0x odd, f0x, f0z and m0y even"),
    ):
        error = float(np.abs(mirrored - values).max())
        results.append(
            Statement(f"The reactions are {text}", f"largest deviation {error:.1e}", error < _ZERO)
        )
    return results


def _sizes(scan: Scan, rows: list[int]) -> list[Statement]:
    distances = np.abs(Y0[rows])
    results = []
    for name, values, unit in (
        ("force", scan.reactions.force, "EI/L²"),
        ("moment", scan.reactions.moment, "EI/L"),
    ):
        largest = np.linalg.norm(values, axis=-1)[rows].max(axis=1)
        by_distance = [float(largest[distances == y].max()) for y in np.unique(distances)]
        shown = ", ".join(f"{value:.3f}" for value in by_distance)
        falling = all(a > b for a, b in pairwise(by_distance))
        results.append(
            Statement(
                f"The support {name} is largest for small |y0|",
                f"largest at |y0| = 0.1 … 0.5: {shown} {unit}",
                falling,
            )
        )
    return results


def _phases(scan: Scan, rows: list[int]) -> list[Statement]:
    kinds = scan.kind[rows]
    touching = {
        abs(float(y))
        for y, row in zip(Y0[rows], kinds, strict=True)
        if (row == ContactKind.TANGENTIAL).any()
    }
    tip_only = sorted({abs(float(y)) for y in Y0[rows]} - touching)
    snaps = sum(event.kind == EventKind.SNAP for event in scan.events if event.trail in rows)
    released = [
        event for event in scan.events if event.kind == EventKind.DETACH and event.trail in rows
    ]
    met = {
        event.trail: event.clamp[0]
        for event in scan.events
        if event.kind == EventKind.FIRST_CONTACT
    }
    mirrored = max(
        (abs(float(event.clamp[0] + met[event.trail])) for event in released), default=np.inf
    )
    shortest = [
        float(np.nanmin(scan.arc_length[lane]))
        for lane in rows
        if (scan.kind[lane] == ContactKind.TANGENTIAL).any()
    ]
    return [
        Statement(
            "For large |y0| the rod touches with its tip only",
            f"tip only on |y0| = {', '.join(map(str, tip_only))}",
            tip_only == [0.4, 0.5],
        ),
        Statement(
            "For small |y0| tip contact turns into tangential contact and back",
            f"tangential on |y0| = {', '.join(map(str, sorted(touching)))}; least s1 = {min(shortest):.5f} L",
            touching == {0.1, 0.2, 0.3},
        ),
        Statement(
            "For y0 ≠ 0 there is no snap-off: the force falls to zero at detachment",
            f"{snaps} snaps, {len(released)} smooth detachments",
            snaps == 0 and len(released) == len(rows),
        ),
        Statement(
            "Detachment mirrors first contact",
            f"largest difference {mirrored:.1e} L",
            mirrored < _ZERO,
        ),
    ]


def _sequences(found: Reconstruction, scan: Scan, rows: list[int]) -> list[Statement]:
    kinks = [angle for lane in rows for angle in _edges(found.point[lane], scan.kind[lane])]
    smooth = max(_largest_turn(found.point[lane], scan.kind[lane]) for lane in rows)
    spacing = np.concatenate([_spacing(found.point[lane]) for lane in rows])
    ratio = float(np.percentile(spacing, 95) / np.percentile(spacing, 5))
    near = np.abs(found.point[rows][..., 0]) < 0.3
    gap = float(np.nanmin(np.where(near, np.abs(found.point[rows][..., 1]), np.nan)))
    return [
        Statement(
            "The sequences have edges where the phase changes",
            f"turn of {min(kinks):.1f}° to {max(kinks):.1f}° at {len(kinks)} phase changes, at most {smooth:.1f}° a step elsewhere",
            min(kinks) > 2 * smooth,
        ),
        Statement(
            "Equal steps of the clamp give contacts of uneven density",
            f"spacing varies by a factor of {ratio:.1f} (5th to 95th percentile)",
            ratio > 2,
        ),
        Statement(
            "A region around the vertex is not reached",
            f"no contact with |x| < 0.3 L comes nearer to the plane y = 0 than {gap:.3f} L",
            gap > 0.3,
        ),
    ]


def _plane(plane: Scan) -> list[Statement]:
    at = {event.kind: event for event in plane.events}
    snap, lateral = at.get(EventKind.SNAP), at.get(EventKind.LATERAL_INSTABILITY)
    force = float(np.nanmax(np.linalg.norm(plane.reactions.force, axis=-1)))
    return [
        Statement(
            "On y0 = 0 the rod stays in the plane and snaps off",
            "no snap"
            if snap is None
            else f"snap at x0 = {snap.clamp[0]:.8f} L with f up to {force:.2f} EI/L²",
            snap is not None and abs(float(snap.clamp[0]) + 1.34212374) < 1e-8,
        ),
        Statement(
            "(beyond the paper) that plane branch is laterally unstable",
            "no instability"
            if lateral is None
            else f"from x0 = {lateral.clamp[0]:.12f} L on, contact at x = {lateral.point[0]:.12f} L",
            lateral is not None and abs(float(lateral.clamp[0]) - 0.474512782442167) < _ZERO,
        ),
    ]


def _inverse(scan: Scan, found: Reconstruction, rows: list[int]) -> Statement:
    error = float(np.nanmax(np.linalg.norm(found.point[rows] - scan.point[rows], axis=-1)))
    total, got = int(scan.in_contact[rows].sum()), int(found.in_contact[rows].sum())
    return Statement(
        "The contact points follow from the reactions alone",
        f"{got} of {total} found, largest error {error:.1e} L",
        error < 1e-10 and got == total,
    )


def _steps(point: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k 3"]:
    return np.diff(point[np.isfinite(point[:, 0])], axis=0)


def _turns(point: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k"]:
    """Angle [°] between each step and the next."""
    steps = _steps(point)
    directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return np.degrees(np.arccos(np.clip(np.sum(directions[1:] * directions[:-1], axis=1), -1, 1)))


def _spacing(point: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "k"]:
    return np.linalg.norm(_steps(point), axis=1)


def _changes(kind: np.ndarray) -> np.ndarray:
    """Indices, within the contacts, of the last one before each phase change."""
    touching = kind[kind != ContactKind.NONE]
    return np.flatnonzero(touching[1:] != touching[:-1])


def _edges(point: Float[np.ndarray, "n 3"], kind: np.ndarray) -> list[float]:
    steps = _steps(point)
    angles = []
    for change in _changes(kind):
        # The step across the change is neither here nor there: compare the one before it with the
        # one behind it.
        before, after = steps[change - 1], steps[change + 1]
        angles.append(
            float(
                np.degrees(
                    np.arccos(before @ after / np.linalg.norm(before) / np.linalg.norm(after))
                )
            )
        )
    return angles


def _largest_turn(point: Float[np.ndarray, "n 3"], kind: np.ndarray) -> float:
    turns = _turns(point)
    near = {index for change in _changes(kind) for index in range(change - 2, change + 2)}
    return float(max(turn for index, turn in enumerate(turns) if index not in near))
