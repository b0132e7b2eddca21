"""A scan as an `xarray.Dataset`."""

from typing import TYPE_CHECKING

import numpy as np

from vibrissa.contacts import Motion
from vibrissa.dataset import Variable, dataset_of, flags
from vibrissa.forward.events import EventKind

if TYPE_CHECKING:
    import xarray

    from vibrissa.forward.result import Scan


def scan_dataset(scan: "Scan") -> "xarray.Dataset":
    """All fields of the scan, its slip and its events."""
    rod, axis = scan.rod, ("axis",)
    length, force, moment, energy, curvature = (
        rod.unit_of(name) for name in ("length", "force", "moment", "energy", "curvature")
    )
    variables = {
        "clamp_position": Variable(scan.trail.position, axis, length, "clamp point"),
        "clamp_orientation": Variable(
            scan.trail.orientation, ("quaternion",), "1", "rotation from clamp to world axes"
        ),
        "contact_point": Variable(scan.point, axis, length, "contact point"),
        "normal": Variable(
            scan.normal, axis, "1", "outward unit normal of the object at the contact"
        ),
        "force_direction": Variable(
            scan.force_direction, axis, "1", "unit vector of the contact force on the rod"
        ),
        "second_contact": Variable(
            scan.second_contact,
            axis,
            length,
            "where the rod also touches the object, on rows that are penetrating",
        ),
        "arc_length": Variable(scan.arc_length, (), length, "arc length from clamp to contact"),
        "support_force": Variable(
            scan.reactions.force, axis, force, "force of the clamp on the rod, world axes"
        ),
        "support_moment": Variable(
            scan.reactions.moment,
            axis,
            moment,
            "moment of the clamp on the rod about the clamp point, world axes",
        ),
        "bending_energy": Variable(scan.energy, (), energy, "bending energy"),
        "largest_curvature": Variable(
            scan.largest_curvature, (), curvature, "largest curvature along the rod"
        ),
        "residual": Variable(scan.residual, (), "1", "largest residual of the contact conditions"),
        "axial_slip": Variable(
            scan.slip.axial,
            (),
            length,
            "motion of the contact along the rod since the last position",
        ),
        "longitudinal_slip": Variable(
            scan.slip.longitudinal,
            (),
            length,
            "motion of the contact point within the bending plane",
        ),
        "lateral_slip": Variable(
            scan.slip.lateral, (), length, "motion of the contact point normal to the bending plane"
        ),
    }
    result = dataset_of(scan.trail.shape, variables, scan.kind, scan.status)
    result["motion"] = (result["kind"].dims, scan.motion, flags(Motion, "how the contact moves"))
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
            {"units": length, "long_name": long_name},
        )
    result.attrs |= {
        "title": "Quasi-static scan of an object with an elastic rod",
        "friction": scan.friction,
        "rod_length": rod.length,
        "rod_bending_stiffness": rod.bending_stiffness,
    }
    return result
