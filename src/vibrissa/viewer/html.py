"""Pieces of HTML: what colours mean, and the numbers of a contact."""

from collections.abc import Sequence
from html import escape

import numpy as np

from vibrissa.contacts import ContactKind, Status
from vibrissa.drawing import BEHIND, FREE, KIND_COLOURS
from vibrissa.viewer.colours import Legend, Scale
from vibrissa.viewer.content import Content, Instant, Rows

_ROW = "display:flex;align-items:center;gap:6px;margin:2px 0;"
_FONT = "font-size:12px;line-height:1.35;padding:2px 10px;"


def legend_html(
    legend: Legend,
    instants: Sequence[Instant],
    notes: Sequence[str],
    surface: Legend | None = None,
) -> str:
    """What the colours of contacts, fitted surfaces and rods mean, and what is left out."""
    lines = []
    if any(len(instant.contacts) for instant in instants):
        lines.append(_title(f"Contacts: {legend.title}"))
    lines += _meanings(legend)
    if surface is not None:
        lines += [_title(f"Surface: {surface.title}"), *_meanings(surface)]
    if any(instant.rods for instant in instants):
        lines.append(_title("Rod"))
        for colour, text in (
            (KIND_COLOURS[ContactKind.TIP], "bent, tip contact"),
            (KIND_COLOURS[ContactKind.TANGENTIAL], "bent, tangential contact"),
            (BEHIND, "behind the contact"),
            (FREE, "without contact"),
        ):
            lines.append(_swatch(colour, text, round_=False))
    if any(np.isfinite(instant.contacts.covariance).any() for instant in instants):
        lines.append("<div style='margin-top:6px'>Ellipsoids hold a contact with 95 %.</div>")
    lines += [f"<div style='margin-top:6px'>{escape(note)}</div>" for note in notes]
    return f"<div style='{_FONT}'>{''.join(lines)}</div>"


def _title(text: str) -> str:
    return f"<div style='margin:6px 0 2px'><b>{escape(text)}</b></div>"


def _meanings(legend: Legend) -> list[str]:
    bar = [] if legend.scale is None else [_bar(legend.scale)]
    return bar + [_swatch(colour, text, round_=True) for colour, text in legend.entries]


def _bar(scale: Scale) -> str:
    """A scale of colours over three numbers."""
    low, middle, high = (f"{value:.3g}" for value in (scale.low, scale.middle, scale.high))
    places = np.linspace(0, 1, 9)
    colours = [f"rgb({r:.0f}, {g:.0f}, {b:.0f})" for r, g, b in scale.colours(places)]
    bar = f"height:10px;background:linear-gradient(to right,{','.join(colours)})"
    numbers = f"<span>≤ {low}</span><span>{middle}</span><span>≥ {high}</span>"
    row = "display:flex;justify-content:space-between"
    return f"<div style='{bar}'></div><div style='{row}'>{numbers}</div>"


def _swatch(colour: str, text: str, *, round_: bool) -> str:
    shape = "width:10px;height:10px;border-radius:5px" if round_ else "width:16px;height:3px"
    mark = f"<span style='{shape};background:{colour};flex:none'></span>"
    return f"<div style='{_ROW}'>{mark}<span>{escape(text)}</span></div>"


def numbers_html(rows: Rows | None, content: Content) -> str:
    """The numbers of one contact, or how to get them."""
    if rows is None:
        return f"<div style='{_FONT}'>Click on a contact to see its numbers.</div>"
    unit, status = content.unit, Status(int(rows.status[0]))

    def vector(values: np.ndarray, of: str) -> str:
        return "(" + ", ".join(f"{value:.4g}" for value in values) + f") {of}"

    said = {
        "point": vector(rows.point[0], unit),
        "normal": vector(rows.normal[0], ""),
        "kind": ContactKind(int(rows.kind[0])).name.lower(),
        "status": f"{status.name}: {status.text}",
        "arc length": f"{rows.arc_length[0]:.4g} {unit}",
        "support force": f"{rows.force[0]:.4g} {content.force_unit}",
        "time": f"{rows.time[0]:.4f} s",
        "deviations": vector(np.sqrt(np.diag(rows.covariance[0])), unit),
    }
    known = {
        "normal": rows.normal,
        "arc length": rows.arc_length,
        "support force": rows.force,
        "time": rows.time,
        "deviations": rows.covariance,
    }
    cells = "".join(
        f"<tr><td style='padding-right:8px;vertical-align:top'><b>{name}</b></td>"
        f"<td>{escape(text)}</td></tr>"
        for name, text in said.items()
        if name not in known or np.isfinite(known[name]).all()
    )
    return f"<table style='{_FONT}'>{cells}</table>"
