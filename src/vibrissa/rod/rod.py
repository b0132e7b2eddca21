"""Uniform straight rod, clamped at one end."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import jax

from vibrissa.geometry.checks import positive

if TYPE_CHECKING:
    Figure: TypeAlias = float
else:
    # A JAX tracer when differentiating with respect to the rod.
    Figure = float | jax.Array

FIRST_CLAMPED_ROOT = 1.8751040687119611
"""First root of cos β cosh β = −1, clamped-free beam (Euler–Bernoulli)."""

_LARGEST_RADIUS = 1e6
_SPECIFIC_STIFFNESS = 25e6
"""E/ρ [J/kg] of steel, aluminium and titanium, each within a tenth; that of copper, nitinol and
gold is lower.
"""
_GRAVITY = 9.80665
"""Standard acceleration [m/s²]."""
Quantity: TypeAlias = Literal["length", "area", "force", "moment", "energy", "curvature", "number"]
_SI_UNITS: dict[Quantity, str] = {
    "length": "m",
    "area": "m2",
    "force": "N",
    "moment": "N m",
    "energy": "J",
    "curvature": "m-1",
    "number": "1",
}


@dataclass(frozen=True)
class Rod:
    """Uniform, straight, unshearable, inextensible rod of isotropic section (paper, section II).

    A pytree: its values may be JAX numbers, so that whatever is computed with `vibrissa.contact`
    can be differentiated with respect to them.

    All results come in the units in which the rod is given: SI, or the model's own (L = EI = 1;
    paper, eq. 1).

    Attributes
    ----------
    length
        L [m].
    bending_stiffness
        EI [N m²].
    radius
        Of the section [m]; needed for strains.
    linear_density
        ρA [kg/m]; needed for natural frequencies.
    yield_strain
        Largest bending strain allowed [1]; a scan marks positions beyond it.
    units
        "SI", or "model" for lengths in L, forces in EI/L² and moments in EI/L: what files and
        figures show beside the numbers.

    Raises
    ------
    ValueError
        If a value is not positive and finite, or a yield strain is given without a radius.
    """

    length: Figure
    bending_stiffness: Figure
    radius: Figure | None = None
    linear_density: Figure | None = None
    yield_strain: Figure | None = None
    units: Literal["SI", "model"] = "SI"

    def __post_init__(self) -> None:
        for name in ("length", "bending_stiffness", "radius", "linear_density", "yield_strain"):
            value = getattr(self, name)
            given = value is not None or name in ("length", "bending_stiffness")
            if given and not isinstance(value, jax.Array):
                object.__setattr__(self, name, positive(value, name))
        if self.yield_strain is not None and self.radius is None:
            raise ValueError(
                f"yield_strain = {self.yield_strain}: needs radius, since bending strain is "
                "radius times curvature"
            )

    @classmethod
    def unit(cls) -> "Rod":
        """The model's own units: L = EI = 1 (paper, eq. 1)."""
        return cls(length=1.0, bending_stiffness=1.0, units="model")

    @classmethod
    def cylinder(
        cls,
        *,
        length: float,
        radius: float,
        youngs_modulus: float,
        density: float | None = None,
        yield_strain: float | None = None,
    ) -> "Rod":
        """Return a wire of circular section: EI = E π r⁴/4. SI units: m, m, Pa, kg/m³, 1."""
        second_moment = math.pi / 4 * math.pow(min(positive(radius, "radius"), _LARGEST_RADIUS), 4)
        if radius > _LARGEST_RADIUS:
            raise ValueError(
                f"radius = {radius!r}; allowed is a number greater than 0 and at most "
                f"{_LARGEST_RADIUS:g}"
            )
        stiffness = positive(youngs_modulus, "youngs_modulus") * second_moment
        linear_density = (
            None if density is None else positive(density, "density") * math.pi * radius**2
        )
        return cls(
            length,
            stiffness,
            radius=radius,
            linear_density=linear_density,
            yield_strain=yield_strain,
        )

    @property
    def force_scale(self) -> Figure:
        """EI/L² [N]."""
        return self.bending_stiffness / self.length**2

    @property
    def moment_scale(self) -> Figure:
        """EI/L [N m], also the scale of energy [J]."""
        return self.bending_stiffness / self.length

    def unit_of(self, quantity: Quantity) -> str:
        """Unit of a quantity as files write it: SI, or "1" in the model's units."""
        return _SI_UNITS[quantity] if self.units == "SI" else "1"

    def first_natural_frequency(self) -> float:
        """First bending frequency [Hz] of the clamped rod with a free end: β² √(EI/(ρA L⁴)) / 2π, β
        = 1.8751.

        Raises
        ------
        ValueError
            If the rod has no density.
        """
        if self.linear_density is None:
            raise ValueError("linear_density = None: a natural frequency needs the rod's density")
        return (
            FIRST_CLAMPED_ROOT**2
            / (2 * math.pi)
            * math.sqrt(self.bending_stiffness / (self.linear_density * self.length**4))
        )

    def own_sag(self) -> float | None:
        """Tip sag [m] of the horizontal rod under its own weight, ρA g L⁴/(8 EI); None if unknown.

        Without a density, a round SI rod is taken to be of a light or common metal, ρ = E/(25
        MJ/kg) as for steel, aluminium and titanium: about the least that a wire of this stiffness
        weighs, since most other metals are heavier.
        """
        weight = self.linear_density
        if weight is None and self.units == "SI" and self.radius is not None:
            weight = 4 * self.bending_stiffness / (self.radius**2 * _SPECIFIC_STIFFNESS)
        return (
            None
            if weight is None or self.units != "SI"
            else weight * _GRAVITY * self.length**4 / (8 * self.bending_stiffness)
        )


_FIGURES = ("length", "bending_stiffness", "radius", "linear_density", "yield_strain")


def _of_figures(units: Literal["SI", "model"], figures: Iterable[Any]) -> Rod:
    """Return a rod of whatever JAX puts into its trees: already checked, or not a number."""
    rod = object.__new__(Rod)
    for name, figure in zip((*_FIGURES, "units"), (*figures, units), strict=True):
        object.__setattr__(rod, name, figure)
    return rod


jax.tree_util.register_pytree_node(
    Rod, lambda rod: (tuple(getattr(rod, name) for name in _FIGURES), rod.units), _of_figures
)
