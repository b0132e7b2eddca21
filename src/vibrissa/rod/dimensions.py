"""Stiffness and mass of a rod from its dimensions and material: fields of `Rod`."""

import math
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite_array, not_negative, positive
from vibrissa.rod.section import Section, check_within, column

_LARGEST_RADIUS = 1e6


def round_section(
    name: str,
    radius: float,
    inner_radius: float,
    youngs_modulus: float,
    density: float | None,
) -> dict[str, Any]:
    """Fields at the clamp of a rod of circular section, E π (r⁴ − rᵢ⁴)/4 and ρ π (r² − rᵢ²); `name`
    is what messages call the radius.
    """
    outer, inner = positive(radius, name), not_negative(inner_radius, "inner_radius")
    if outer > _LARGEST_RADIUS:
        raise ValueError(
            f"{name} = {radius!r}; allowed is a number greater than 0 and at most "
            f"{_LARGEST_RADIUS:g}"
        )
    if inner >= outer:
        raise ValueError(
            f"inner_radius = {inner!r}; allowed is a number of at least 0 and below "
            f"{name} = {outer!r}"
        )
    second_moment = math.pi / 4 * (outer**4 - inner**4)
    return {
        "bending_stiffness": positive(youngs_modulus, "youngs_modulus") * second_moment,
        "radius": outer,
        "linear_density": None
        if density is None
        else positive(density, "density") * (math.pi * (outer**2 - inner**2)),
        "inner_radius": inner,
    }


def taper_between(base: float, tip_radius: float, bore: float) -> Section | None:
    """The section of a rod with a linear radius and a bore of one radius."""
    tip = not_negative(tip_radius, "tip_radius")
    if bore and bore >= tip:
        raise ValueError(
            f"inner_radius = {bore!r}; allowed is a number of at least 0 and below "
            f"tip_radius = {tip!r}"
        )
    columns = {"bore": (bore / base, bore / base)} if bore else {}
    return Section.table((0.0, 1.0), radius=(1.0, tip / base), **columns)


def round_table(
    s: Float[np.ndarray, "k"],
    radius: ArrayLike | None,
    inner_radius: ArrayLike,
    youngs_modulus: float | None,
    density: float | None,
) -> dict[str, Any]:
    """Fields of a rod whose radii are given at arc lengths."""
    for name, value in (("radius", radius), ("youngs_modulus", youngs_modulus)):
        if value is None:
            raise ValueError(
                f"{name} = None; allowed are tables of radius with a youngs_modulus, or of "
                "bending_stiffness and torsional_stiffness"
            )
    outer = column(radius, "radius", len(s))  # type: ignore[arg-type]
    inner = finite_array(inner_radius, "inner_radius")
    inner = inner if inner.ndim else np.full(len(s), float(inner))
    inner = finite_array(inner, "inner_radius", last=len(s), ndim=1)
    check_within(inner, outer, "inner_radius", "radius")
    found = round_section("radius[0]", outer[0], inner[0], youngs_modulus or 0.0, density)
    bored = inner / outer[0] if inner.any() else None
    return found | {"section": Section.table(s / s[-1], radius=outer / outer[0], bore=bored)}


def stiffness_table(
    s: Float[np.ndarray, "k"],
    bending_stiffness: ArrayLike | None,
    torsional_stiffness: ArrayLike | None,
    linear_density: ArrayLike | None,
    radius: ArrayLike | None,
) -> dict[str, Any]:
    """Fields of a rod whose EI and GJ are given at arc lengths."""
    names = ("bending_stiffness", "torsional_stiffness", "linear_density", "radius")
    values = (bending_stiffness, torsional_stiffness, linear_density, radius)
    given = dict(zip(names, values, strict=True))
    for name in names[:2]:
        if given[name] is None:
            raise ValueError(
                f"{name} = None; allowed are {len(s)} numbers: a table of stiffness has bending "
                "and torsion"
            )
    table = {name: column(one, name, len(s)) for name, one in given.items() if one is not None}
    base = {name: float(values[0]) for name, values in table.items()}
    scale = base | {"torsional_stiffness": base["bending_stiffness"]}
    relative = {name: values / scale[name] for name, values in table.items()}
    relative["bending"] = relative.pop("bending_stiffness")
    relative["torsion"] = relative.pop("torsional_stiffness")
    del base["torsional_stiffness"]
    return base | {"section": Section.table(s / s[-1], **relative)}
