"""Reactions along one trail, with its events."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float, Int
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from vibrissa.contacts import Status
from vibrissa.drawing import length_factor
from vibrissa.forward import Event, EventKind, Scan
from vibrissa.numerics.runs import runs
from vibrissa.plot.arguments import checked
from vibrissa.plot.style import COLUMN, length_label, no_contact, status_words

MARKERS = dict(zip(EventKind, "osDvX^<P>d*", strict=True))
# At these the rod is as without contact.
_FREE = (EventKind.FIRST_CONTACT, EventKind.DETACH, EventKind.HEAD_ON)
_EVENT_COLOUR = "#c1121f"


@checked
def reactions_along(scan: Scan) -> list[Axes]:
    """Contact force and arc length along one trail (n, …), with its events; dashed where the branch
    is laterally unstable, dotted where a row's status is not OK for another reason. Of a rod that
    weight or wind load, the support force.

    They are drawn over the clamp's coordinate that changes most, in the direction of the sweep, or
    over the share of the trail if the clamp turns back. Curves break off at snaps.

    Raises
    ------
    ValueError
        If the scan has several trails, or no contact.
    """
    if scan.kind.ndim != 1:
        raise ValueError(f"scan has the shape {scan.kind.shape}; allowed is one trail (n,)")
    if not scan.in_contact.any():
        raise no_contact(scan.status, "positions")
    force = np.linalg.norm(scan.reactions.force, axis=-1)
    free, at = np.isfinite(force) & ~scan.in_contact, [one.parameter for one in scan.events]
    # That of the rod's own loads.
    least = np.zeros(len(at))
    if scan.rod.loads is not None and free.any():
        least = np.interp(at, scan.trail.parameter[free], force[free])
    force = np.where(scan.in_contact, force, np.nan)
    factor = length_factor(scan.rod)
    rod, touching = scan.rod, np.flatnonzero(scan.in_contact)
    reach = np.array([np.linalg.norm(event.point - event.clamp) for event in scan.events])
    if not (rod.rest is None and rod.loads is None and rod.support is None):
        # The free rod is not straight: that of the nearest contact.
        apart = abs(scan.trail.parameter[touching] - np.reshape(at, (-1, 1)))
        reach = scan.arc_length[touching[np.argmin(apart, axis=1)]] if at else reach
    place, label = _abscissa(scan)
    figure, panels = plt.subplots(
        2, 1, figsize=(COLUMN * 1.4, COLUMN * 1.3), sharex=True, layout="constrained"
    )
    _draw(panels[0], scan, place, force, least)
    _draw(panels[1], scan, place, factor * scan.arc_length, factor * reach)
    unit = "N" if scan.rod.units == "SI" else "$EI/L^2$"
    panels[0].set_ylabel(f"{'$f$' if scan.rod.loads is None else 'support force'} [{unit}]")
    panels[1].set(xlabel=label, ylabel=length_label("s_1", scan.rod))
    if place[0] > place[-1]:
        panels[1].invert_xaxis()
    handles, names = panels[0].get_legend_handles_labels()
    once = dict(zip(names, handles, strict=True))
    figure.legend(once.values(), once.keys(), loc="outside upper center", ncols=2, handlelength=1.8)
    return list(panels)


def _abscissa(scan: Scan) -> tuple[Float[np.ndarray, "n"], str]:
    """Where on the trail each row is, and the label of that axis."""
    position = scan.trail.position
    axis = int(np.argmax(np.ptp(position, axis=0)))
    steps = np.diff(position[:, axis])
    if np.all(steps > 0) or np.all(steps < 0):
        label = length_label(f"{'xyz'[axis]}_0", scan.rod)
        return length_factor(scan.rod) * position[:, axis], label
    return scan.trail.parameter, "share of the trail"


def _draw(
    axes: Axes,
    scan: Scan,
    place: Float[np.ndarray, "n"],
    values: Float[np.ndarray, "n"],
    free: Float[np.ndarray, "events"],
) -> None:
    """A curve in the style of its rows' statuses, with the events on it; `free` are its values
    at those events at which the rod is as without contact.
    """
    along, known = scan.trail.parameter, np.isfinite(values)
    at = np.array([event.parameter for event in scan.events])
    marked = [
        _value(event, along, values, end) for event, end in zip(scan.events, free, strict=True)
    ]
    # The curve begins and ends where the contact does, and breaks off where the rod snaps.
    ends = np.array([event.kind in _FREE for event in scan.events], dtype=bool)
    snaps = np.array([event.kind == EventKind.SNAP for event in scan.events], dtype=bool)
    vertices = np.concatenate([along[known], at[ends], at[snaps]])
    course = np.concatenate([values[known], free[ends], np.full(snaps.sum(), np.nan)])
    order = np.argsort(vertices, kind="stable")
    vertices, course = vertices[order], course[order]
    rows = np.flatnonzero(known)
    before = np.maximum(np.searchsorted(along[known], vertices, side="right") - 1, 0)
    status, x = scan.status[rows[before]], np.interp(vertices, along, place)
    for codes, style, label in _styles(scan.status[known]):
        for first, last in runs(np.isin(status, codes)):
            # Each step belongs to the row that it begins at.
            drawn = slice(first, last + 1)
            axes.plot(x[drawn], course[drawn], color="black", linestyle=style, label=label)
    for event, value in zip(scan.events, marked, strict=True):
        axes.plot(
            np.interp(event.parameter, along, place),
            value,
            MARKERS[event.kind],
            color=_EVENT_COLOUR,
            markersize=6,
            markeredgecolor="white",
            markeredgewidth=0.5,
            label=event.kind.name.lower().replace("_", " "),
            clip_on=False,
        )


def _value(
    event: Event, along: Float[np.ndarray, "n"], values: Float[np.ndarray, "n"], free: float
) -> float:
    """What a curve is at an event: as far as it is known, between its neighbours; before a snap."""
    if event.kind in _FREE:
        return free
    after = int(np.searchsorted(along, event.parameter))
    pair = np.clip([after - 1, after], 0, len(along) - 1)
    pair = pair[:1] if event.kind == EventKind.SNAP else pair
    pair = pair[np.isfinite(values[pair])]
    return float(np.interp(event.parameter, along[pair], values[pair])) if len(pair) else np.nan


def _styles(status: Int[np.ndarray, "k"]) -> Iterator[tuple[list[int], object, str]]:
    """Statuses that are drawn alike, with their line style and label."""
    unstable, present = int(Status.LATERALLY_UNSTABLE), set(status.tolist())
    others = sorted(present - {int(Status.OK), unstable})
    for codes, style in (([0], "-"), ([unstable], (0, (3, 2))), (others, ":")):
        own = np.isin(status, codes)
        if own.any():
            yield codes, style, "stable" if codes == [0] else status_words(status[own])
