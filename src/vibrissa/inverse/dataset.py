"""A reconstruction as an `xarray.Dataset`."""

from typing import TYPE_CHECKING

from vibrissa.dataset import Variable, dataset_of

if TYPE_CHECKING:
    import xarray

    from vibrissa.inverse.result import Reconstruction

_VARIABLES = (
    Variable(
        "normal",
        "normal",
        "axis",
        "number",
        "outward unit normal of the object, as far as it is known",
    ),
    Variable(
        "force_direction",
        "force_direction",
        "axis",
        "number",
        "unit vector of the contact force on the rod",
    ),
    Variable(
        "incidence", "modulus", "", "number", "(1 + t·d)/2 of rod tangent t and force direction d"
    ),
    Variable(
        "single_contact_residual", "single_contact_residual", "", "number", "violation of m0·f0 = 0"
    ),
    Variable(
        "contact_point_covariance",
        "covariance",
        "axis other_axis",
        "area",
        "covariance of the contact point",
    ),
    Variable(
        "normal_covariance",
        "normal_covariance",
        "axis other_axis",
        "number",
        "covariance of the normal",
    ),
    Variable(
        "cross_covariance",
        "cross_covariance",
        "axis other_axis",
        "length",
        "covariance of the contact point with the normal",
    ),
    Variable(
        "contact_point_covariance_noise",
        "covariance_noise",
        "axis other_axis",
        "area",
        "covariance of the contact point, what varies from sample to sample",
    ),
    Variable(
        "contact_point_shared",
        "shared",
        "axis shared_parameter",
        "length",
        "what one standard deviation of each parameter of the setup does to all contact points",
    ),
    Variable(
        "normal_shared",
        "shared_normal",
        "axis shared_parameter",
        "number",
        "the same of all normals",
    ),
)


def reconstruction_dataset(found: "Reconstruction") -> "xarray.Dataset":
    """All fields of the reconstruction, with its covariances where the noise is known."""
    result = dataset_of("Contacts reconstructed from support reactions", found, _VARIABLES)
    if found.shared_names:
        result = result.assign_coords(shared_parameter=list(found.shared_names))
    if found.reactions.time is not None:
        about = {"units": "s", "long_name": "time of the sample"}
        result["time"] = (result["kind"].dims, found.reactions.time, about)
    return result
