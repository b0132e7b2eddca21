"""A reconstruction as an `xarray.Dataset`."""

from operator import attrgetter
from typing import TYPE_CHECKING

from vibrissa.dataset import Variable, dataset_of

if TYPE_CHECKING:
    import xarray

    from vibrissa.inverse.result import Reconstruction

_VARIABLES = (
    ("clamp_position", "reactions.trail.position", "axis", "length", "clamp point"),
    (
        "clamp_orientation",
        "reactions.trail.orientation",
        "quaternion",
        "1",
        "rotation from clamp to world axes",
    ),
    (
        "support_force",
        "reactions.force",
        "axis",
        "force",
        "force of the clamp on the rod, world axes",
    ),
    (
        "support_moment",
        "reactions.moment",
        "axis",
        "moment",
        "moment of the clamp on the rod about the clamp point, world axes",
    ),
    ("contact_point", "point", "axis", "length", "contact point"),
    (
        "normal",
        "normal",
        "axis",
        "1",
        "unit vector of the contact force on the rod; the object's outward normal without friction",
    ),
    ("arc_length", "arc_length", "", "length", "arc length from clamp to contact"),
    ("bending_energy", "energy", "", "energy", "bending energy"),
    ("single_contact_residual", "single_contact_residual", "", "1", "violation of m0·f0 = 0"),
    (
        "contact_point_covariance",
        "covariance",
        "axis other_axis",
        "area",
        "covariance of the contact point",
    ),
    (
        "normal_covariance",
        "normal_covariance",
        "axis other_axis",
        "1",
        "covariance of the normal",
    ),
    (
        "contact_point_covariance_noise",
        "covariance_noise",
        "axis other_axis",
        "area",
        "covariance of the contact point, what varies from sample to sample",
    ),
    (
        "contact_point_shared",
        "shared",
        "axis shared_parameter",
        "length",
        "what one standard deviation of each parameter of the setup does to all contact points",
    ),
    ("normal_shared", "shared_normal", "axis shared_parameter", "1", "the same of all normals"),
)
"""Name, field, axes of one row, quantity or unit, and long name."""


def reconstruction_dataset(found: "Reconstruction") -> "xarray.Dataset":
    """All fields of the reconstruction, with its covariances where the noise is known."""
    rod, names = found.rod, found.shared_names
    units = {name: rod.unit_of(name) for name in ("length", "force", "moment", "energy")}
    units["area"] = "m2" if rod.units == "SI" else "1"
    variables = {}
    for name, field, axes, quantity, text in _VARIABLES:
        values = attrgetter(field)(found)
        # Nothing is shared without tolerances.
        if values is not None and values.size:
            unit = units.get(quantity, quantity)
            variables[name] = Variable(values, tuple(axes.split()), unit, text)
    result = dataset_of(found.kind.shape, variables, found.kind, found.status)
    if names:
        result = result.assign_coords(shared_parameter=list(names))
    if found.reactions.time is not None:
        about = {"units": "s", "long_name": "time of the sample"}
        result["time"] = (result["kind"].dims, found.reactions.time, about)
    result.attrs |= {
        "title": "Contacts reconstructed from support reactions",
        "rod_length": rod.length,
        "rod_bending_stiffness": rod.bending_stiffness,
    }
    if found.friction is not None:
        result.attrs["friction"] = found.friction
    return result
