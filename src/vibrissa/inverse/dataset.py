"""A reconstruction as an `xarray.Dataset`."""

from typing import TYPE_CHECKING

from vibrissa.dataset import Variable, dataset_of

if TYPE_CHECKING:
    import xarray

    from vibrissa.inverse.result import Reconstruction


def reconstruction_dataset(found: "Reconstruction") -> "xarray.Dataset":
    """All fields of the reconstruction, with its covariances where the noise is known."""
    rod, reactions, axis = found.rod, found.reactions, ("axis",)
    length, force, moment = (rod.unit_of(name) for name in ("length", "force", "moment"))
    variables = {
        "clamp_position": Variable(reactions.trail.position, axis, length, "clamp point"),
        "clamp_orientation": Variable(
            reactions.trail.orientation, ("quaternion",), "1", "rotation from clamp to world axes"
        ),
        "support_force": Variable(
            reactions.force, axis, force, "force of the clamp on the rod, world axes"
        ),
        "support_moment": Variable(
            reactions.moment,
            axis,
            moment,
            "moment of the clamp on the rod about the clamp point, world axes",
        ),
        "contact_point": Variable(found.point, axis, length, "contact point"),
        "normal": Variable(
            found.normal,
            axis,
            "1",
            "unit vector of the contact force on the rod; the object's outward normal without "
            "friction",
        ),
        "arc_length": Variable(found.arc_length, (), length, "arc length from clamp to contact"),
        "bending_energy": Variable(found.energy, (), rod.unit_of("energy"), "bending energy"),
        "single_contact_residual": Variable(
            found.single_contact_residual, (), "1", "violation of m0·f0 = 0"
        ),
    }
    if (
        found.covariance is not None
        and found.normal_covariance is not None
        and found.covariance_noise is not None
    ):
        pair = ("axis", "other_axis")
        area = "m2" if rod.units == "SI" else "1"
        variables["contact_point_covariance"] = Variable(
            found.covariance, pair, area, "covariance of the contact point"
        )
        variables["normal_covariance"] = Variable(
            found.normal_covariance, pair, "1", "covariance of the normal"
        )
        variables["contact_point_covariance_noise"] = Variable(
            found.covariance_noise,
            pair,
            area,
            "covariance of the contact point, what varies from sample to sample",
        )
    if found.shared_names:
        shared = ("axis", "shared_parameter")
        variables["contact_point_shared"] = Variable(
            found.shared,
            shared,
            length,
            "what one standard deviation of each parameter of the setup does to all contact points",
        )
        variables["normal_shared"] = Variable(
            found.shared_normal, shared, "1", "the same of all normals"
        )
    result = dataset_of(reactions.trail.shape, variables, found.kind, found.status)
    if found.shared_names:
        result = result.assign_coords(shared_parameter=list(found.shared_names))
    if reactions.time is not None:
        result["time"] = (
            result["kind"].dims,
            reactions.time,
            {"units": "s", "long_name": "time of the sample"},
        )
    result.attrs |= {
        "title": "Contacts reconstructed from support reactions",
        "rod_length": rod.length,
        "rod_bending_stiffness": rod.bending_stiffness,
    }
    return result
