"""A scan as an `xarray.Dataset`."""

from typing import TYPE_CHECKING

import numpy as np

from vibrissa.contacts import Motion
from vibrissa.dataset import Variable, dataset_of, flags
from vibrissa.forward.events import EventKind

if TYPE_CHECKING:
    import xarray

    from vibrissa.forward.result import Scan


_VARIABLES = (
    Variable(
        "normal", "normal", "axis", "number", "outward unit normal of the object at the contact"
    ),
    Variable(
        "force_direction",
        "force_direction",
        "axis",
        "number",
        "unit vector of the contact force on the rod",
    ),
    Variable(
        "second_contact",
        "second_contact",
        "axis",
        "length",
        "where the rod also touches the object, on rows that are penetrating",
    ),
    Variable(
        "largest_curvature",
        "largest_curvature",
        "",
        "curvature",
        "largest curvature along the rod",
    ),
    Variable("residual", "residual", "", "number", "largest residual of the contact conditions"),
    Variable(
        "axial_slip",
        "slip.axial",
        "",
        "length",
        "motion of the contact along the rod since the last position",
    ),
    Variable(
        "longitudinal_slip",
        "slip.longitudinal",
        "",
        "length",
        "motion of the contact point within the bending plane",
    ),
    Variable(
        "lateral_slip",
        "slip.lateral",
        "",
        "length",
        "motion of the contact point normal to the bending plane",
    ),
)


def scan_dataset(scan: "Scan") -> "xarray.Dataset":
    """All fields of the scan, its slip and its events."""
    title = "Quasi-static scan of an object with an elastic rod"
    result = dataset_of(title, scan, _VARIABLES)
    result["motion"] = (result["kind"].dims, scan.motion, flags(Motion, "how the contact moves"))
    result.attrs["finite_radius"] = int(scan.finite_radius)
    result.attrs["contact_offset"] = scan.offset
    events = scan.events
    result["event_kind"] = (
        "event",
        np.array([int(event.kind) for event in events], dtype=np.int8),
        flags(EventKind, "what happened"),
    )
    result["event_trail"] = (
        "event",
        np.array([event.trail for event in events], dtype=np.int64),
        {"long_name": "on which trail"},
    )
    result["event_parameter"] = (
        "event",
        np.array([event.parameter for event in events], dtype=float),
        {"units": "1", "long_name": "0 to 1 along the trail"},
    )
    for name, long_name in (
        ("clamp", "clamp point at the event"),
        ("point", "contact point at the event"),
    ):
        values = np.array([getattr(event, name) for event in events], dtype=float).reshape(-1, 3)
        result[f"event_{name}"] = (
            ("event", "axis"),
            values,
            {"units": scan.rod.unit_of("length"), "long_name": long_name},
        )
    return result
