"""A rod held at one end: its dimensions, stiffness, rest shape, loads and support."""

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite, not_negative, positive
from vibrissa.numerics.compiled import compiled
from vibrissa.rod.beam import first_frequency, sag
from vibrissa.rod.centre_line import check_free
from vibrissa.rod.dimensions import round_section, round_table, stiffness_table, taper_between
from vibrissa.rod.loads import Loads
from vibrissa.rod.rest_shape import Polynomial, RestShape, Table
from vibrissa.rod.section import Section, increasing
from vibrissa.rod.support import Support
from vibrissa.rod.thermal import Thermal
from vibrissa.rod.tree import Described, Figure, known, tree

Along = Float[Any, "..."]

FIRST_CLAMPED_ROOT = 1.8751040687119611
"""First root of cos β cosh β = −1, clamped-free beam (Euler–Bernoulli)."""

_SPECIFIC_STIFFNESS = 25e6
"""E/ρ [J/kg] of steel, aluminium and titanium, each within a tenth; that of copper, nitinol and
gold is lower.
"""
_GRAVITY = 9.80665
"""Standard acceleration [m/s²]."""
_SAME_PLACE = 1e-9  # of the length: kinks of section and rest shape there are one, but for rounding
_INCOMPRESSIBLE = 0.5
"""Largest Poisson's ratio."""
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
_POSITIVE = ("length", "bending_stiffness", "radius", "linear_density", "yield_strain")
_PARTS: dict[str, type] = {
    "section": Section,
    "rest": RestShape,
    "loads": Loads,
    "support": Support,
    "thermal": Thermal,
}


@compiled
def _curvature(rest: RestShape, s: Float[Any, "n"]) -> Float[Any, "n 3"]:
    # Compiling each of its operations by itself would take half a second.
    return rest.at(s)


@tree("units")
@dataclass(frozen=True, eq=False, repr=False)
class Rod(Described):
    """Unshearable, inextensible rod of isotropic section (paper, section II); uniform, straight,
    unloaded and rigidly held unless stated otherwise.

    A pytree: its values may be JAX numbers, so that whatever is computed with `vibrissa.contact`
    can be differentiated with respect to them.

    All results come in the units in which the rod is given: SI, or the model's own (L = EI = 1;
    paper, eq. 1).

    Attributes
    ----------
    length
        L [m].
    bending_stiffness
        EI [N m²] at the clamp.
    radius
        Outer radius at the clamp [m]; needed for strains and wind.
    linear_density
        ρA [kg/m] at the clamp; needed for natural frequencies and gravity.
    yield_strain
        Largest bending strain allowed [1]; a scan marks positions beyond it.
    units
        "SI", or "model" for lengths in L, forces in EI/L² and moments in EI/L: what files and
        figures show beside the numbers.
    section
        How these vary along the rod; None for a uniform one.
    poisson_ratio
        ν [1]: GJ = EI/(1 + ν) for a round section.
    inner_radius
        Of a hollow rod, at the clamp [m].
    rest
        Shape without load; None for a straight rod.
    loads
        Forces along the rod, if any.
    support
        How the clamp yields, if it does.
    thermal
        How the rod changes with temperature, if known.

    Raises
    ------
    ValueError
        If a value is not in its range, or what is given needs a radius or a density that is not;
        if the rod touches itself at rest.
    TypeError
        If section, rest, loads, support or thermal is something else.
    """

    length: Figure
    bending_stiffness: Figure
    radius: Figure | None = None
    linear_density: Figure | None = None
    yield_strain: Figure | None = None
    units: Literal["SI", "model"] = "SI"
    section: Section | None = None
    poisson_ratio: Figure = 0.3
    inner_radius: Figure = 0.0
    rest: RestShape | None = None
    loads: Loads | None = None
    support: Support | None = None
    thermal: Thermal | None = None

    def __post_init__(self) -> None:
        self._check_parts()
        if self.units not in ("SI", "model"):
            raise ValueError(f"units = {self.units!r}; allowed is 'SI' or 'model'")
        for name in _POSITIVE:
            value = getattr(self, name)
            given = value is not None or name in ("length", "bending_stiffness")
            if given and not isinstance(value, jax.Array):
                object.__setattr__(self, name, positive(value, name))
        if known(self.poisson_ratio):
            ratio = finite(self.poisson_ratio, "poisson_ratio")
            if not -1 < ratio <= _INCOMPRESSIBLE:
                raise ValueError(
                    f"poisson_ratio = {ratio!r}; allowed is a number above -1 and at most 0.5"
                )
            object.__setattr__(self, "poisson_ratio", ratio)
        self._check_bore()
        if self.yield_strain is not None and self.radius is None:
            raise ValueError(
                f"yield_strain = {self.yield_strain}: needs radius, since bending strain is "
                "radius times curvature; allowed is a rod with both"
            )
        # What does nothing is left out, so that the rod is as plain as it can be.
        if isinstance(self.rest, Polynomial) and not len(self.rest.coefficients):
            object.__setattr__(self, "rest", None)
        if self.loads is not None and self.loads.none:
            object.__setattr__(self, "loads", None)
        if self.support is not None and self.support.stiffness is None:
            object.__setattr__(self, "support", None)
        if self.loads is not None:
            self._check_loads(self.loads)
        if self.rest is not None and known(self.rest, self.length, self.radius):
            self._check_rest(self.rest)

    def _check_parts(self) -> None:
        for name, part in _PARTS.items():
            value = getattr(self, name)
            if value is not None and not isinstance(value, part):
                raise TypeError(
                    f"{name} = {value!r}; allowed is a vibrissa.{part.__name__}, or None"
                )

    def _check_bore(self) -> None:
        if not known(self.inner_radius, self.radius):
            return
        inner = not_negative(self.inner_radius, "inner_radius")
        if inner and (self.radius is None or inner >= self.radius):
            raise ValueError(
                f"inner_radius = {inner!r}; allowed is a number of at least 0 and below "
                f"radius = {self.radius}"
            )
        object.__setattr__(self, "inner_radius", inner)

    def _check_loads(self, loads: Loads) -> None:
        if loads.gravity is not None:
            if self.linear_density is None:
                raise ValueError("linear_density = None: gravity needs it, or the rod's density")
            self.linear_density_at(0.0)
        if loads.wind is not None:
            if self.units != "SI":
                raise ValueError(f"units = {self.units!r}: wind needs a rod in SI units")
            self.radius_at(0.0)

    def _check_rest(self, rest: RestShape) -> None:
        length = float(self.length)
        rest.check(length)
        check_free(lambda s: np.asarray(_curvature(rest, s)), length, float(self.radius or 0.0))

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
        poisson_ratio: float = 0.3,
        inner_radius: float = 0.0,
        yield_strain: float | None = None,
        thermal: Thermal | None = None,
    ) -> "Rod":
        """Return a wire or tube of circular section: EI = E π (r⁴ − rᵢ⁴)/4. SI units: m, m, Pa,
        kg/m³, 1, m, 1.
        """
        size = round_section("radius", radius, inner_radius, youngs_modulus, density)
        return cls(
            length, **size, poisson_ratio=poisson_ratio, yield_strain=yield_strain, thermal=thermal
        )

    @classmethod
    def tapered(
        cls,
        *,
        length: float,
        base_radius: float,
        tip_radius: float,
        youngs_modulus: float,
        density: float | None = None,
        poisson_ratio: float = 0.3,
        inner_radius: float = 0.0,
        yield_strain: float | None = None,
        thermal: Thermal | None = None,
    ) -> "Rod":
        """Return a rod of circular section whose radius changes linearly from clamp to tip, where 0
        is a cone, which bears no contact at its tip: scans and reconstructions want 1e-4 of the
        base radius. The inner radius is the same all along. SI units, as `cylinder`.
        """
        size = round_section("base_radius", base_radius, inner_radius, youngs_modulus, density)
        section = taper_between(size["radius"], tip_radius, size["inner_radius"])
        return cls(
            length,
            **size,
            section=section,
            poisson_ratio=poisson_ratio,
            yield_strain=yield_strain,
            thermal=thermal,
        )

    @classmethod
    def from_table(
        cls,
        *,
        arc_length: ArrayLike,
        radius: ArrayLike | None = None,
        youngs_modulus: float | None = None,
        density: float | None = None,
        poisson_ratio: float = 0.3,
        inner_radius: ArrayLike = 0.0,
        bending_stiffness: ArrayLike | None = None,
        torsional_stiffness: ArrayLike | None = None,
        linear_density: ArrayLike | None = None,
        yield_strain: float | None = None,
        thermal: Thermal | None = None,
    ) -> "Rod":
        """Return a rod given at arc lengths (k,) [m] from 0 to its length, linear between them.

        Parameters
        ----------
        arc_length
            (k,) increasing, the first 0.
        radius
            (k,) outer radius [m]; the last may be 0.
        youngs_modulus, density, poisson_ratio
            Of the material [Pa], [kg/m³], [1], for a round section.
        inner_radius
            One, or (k,) [m], of a round section.
        bending_stiffness, torsional_stiffness
            (k,) EI and GJ [N m²] instead of a material; the last may be 0.
        linear_density
            (k,) [kg/m] with these, if known.
        yield_strain, thermal
            As of `Rod`.

        Raises
        ------
        ValueError
            If arc lengths do not increase from 0, a column has another length or a value out of
            range, or neither or both of material and stiffness are given.
        """
        s = increasing(arc_length)
        stiffness = {
            "bending_stiffness": bending_stiffness,
            "torsional_stiffness": torsional_stiffness,
            "linear_density": linear_density,
        }
        table = [name for name, column in stiffness.items() if column is not None]
        if not table:
            found = round_table(s, radius, inner_radius, youngs_modulus, density)
        else:
            for name, value in (("youngs_modulus", youngs_modulus), ("density", density)):
                if value is not None:
                    raise ValueError(
                        f"{name} = {value!r}; allowed is None where {table[0]} is given"
                    )
            if np.any(inner_radius):
                raise ValueError(
                    f"inner_radius = {inner_radius!r}; allowed is 0 where {table[0]} is given"
                )
            found = stiffness_table(s, **stiffness, radius=radius)
        return cls(
            float(s[-1]),
            **found,
            poisson_ratio=poisson_ratio,
            yield_strain=yield_strain,
            thermal=thermal,
        )

    def curved(self, rest: RestShape) -> "Rod":
        """The rod with a rest shape.

        Raises
        ------
        ValueError
            If it does not fit the length, or the rod would touch itself.
        """
        return replace(self, rest=rest)

    def loaded(self, loads: Loads) -> "Rod":
        """The rod with forces along it.

        Raises
        ------
        ValueError
            If there is gravity without a density, or wind without a radius.
        """
        return replace(self, loads=loads)

    def on(self, support: Support) -> "Rod":
        """The rod on a support."""
        return replace(self, support=support)

    def at(self, temperature: Figure) -> "Rod":
        """The rod as it is at a temperature [°C]: its modulus, length, radii and rest shape. Its
        mass stays.

        Raises
        ------
        ValueError
            If `thermal` is not known, or the modulus or a length would not be positive.
        """
        if self.thermal is None:
            raise ValueError(
                f"temperature = {temperature!r}: thermal = None; the rod needs "
                "Thermal(modulus_slope=, expansion=)"
            )
        modulus, stretch = self.thermal.factors(temperature)
        return replace(
            self,
            length=self.length * stretch,
            bending_stiffness=self.bending_stiffness * modulus * stretch**4,
            radius=None if self.radius is None else self.radius * stretch,
            inner_radius=self.inner_radius * stretch,
            linear_density=None if self.linear_density is None else self.linear_density / stretch,
            rest=None if self.rest is None else self.rest.scaled(stretch),
            thermal=self.thermal.at(temperature),
        )

    @property
    def uniform(self) -> bool:
        """Whether the section is the same all along."""
        return self.section is None

    @property
    def plain(self) -> bool:
        """Whether the closed form applies: uniform, straight, unloaded and rigidly held."""
        return (self.section, self.rest, self.loads, self.support) == (None,) * 4

    @property
    def breaks(self) -> tuple[float, ...]:
        """Fractions of the length, between 0 and 1, where the section or the rest shape has a kink;
        increasing.
        """
        places = [] if self.section is None else list(self.section.breaks)
        if isinstance(self.rest, Table):
            given = known(self.rest.extent, self.length)
            share = float(self.rest.extent / self.length) if given else 1.0
            places += [share * place for place in self.rest.breaks]
        places.sort()
        return tuple(
            place
            for before, place in zip([0.0, *places], places, strict=False)
            if place - before > _SAME_PLACE and place < 1
        )

    @property
    def second_moment(self) -> Figure | None:
        """Second moment of area of the round section at the clamp, I = π (r⁴ − rᵢ⁴)/4 [m⁴]; None
        without a radius.
        """
        if self.radius is None:
            return None
        return math.pi / 4 * (self.radius**4 - self.inner_radius**4)

    def bending_at(self, x: ArrayLike) -> Along:
        """EI [EI at the clamp] at fractions x of the length (…); traceable by JAX."""
        return jnp.ones(np.shape(x)) if self.section is None else self.section.bending_at(x)

    def torsion_at(self, x: ArrayLike) -> Along:
        """GJ [EI at the clamp] at fractions of the length (…)."""
        if self.section is None:
            return jnp.ones(np.shape(x)) / (1 + self.poisson_ratio)
        return self.section.torsion_at(x, self.poisson_ratio)

    def radius_at(self, x: ArrayLike) -> Along:
        """Outer radius [m] at fractions of the length (…).

        Raises
        ------
        ValueError
            If it is not known.
        """
        if self.radius is None:
            raise ValueError("radius = None; needed is the rod's radius")
        if self.section is None:
            return self.radius * jnp.ones(np.shape(x))
        return self.radius * self.section.radius_at(x)

    def linear_density_at(self, x: ArrayLike) -> Along:
        """Mass per length [kg/m] at fractions of the length (…).

        Raises
        ------
        ValueError
            If it is not known.
        """
        if self.linear_density is None:
            raise ValueError("linear_density = None; needed is the rod's density")
        if self.section is None:
            return self.linear_density * jnp.ones(np.shape(x))
        return self.linear_density * self.section.linear_density_at(x)

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
        = 1.8751; of a rod that varies, by beam elements (1e-7). Rest shape, loads and support are
        left out.

        Raises
        ------
        ValueError
            If the rod has no density.
        """
        if self.linear_density is None:
            raise ValueError("linear_density = None: a natural frequency needs the rod's density")
        shape = FIRST_CLAMPED_ROOT**2
        if self.section is not None:
            shape = first_frequency(
                self.section.bending_at, self.section.linear_density_at, self.breaks
            )
        return (
            shape
            / (2 * math.pi)
            * math.sqrt(self.bending_stiffness / (self.linear_density * self.length**4))
        )

    def own_sag(self) -> float | None:
        """Tip sag [m] of the horizontal rod under its own weight, ρA g L⁴/(8 EI) for a uniform one;
        None if unknown.

        Without a density, a round SI rod is taken to be of a light or common metal, ρ = E/(25
        MJ/kg) as for steel, aluminium and titanium: about the least that a wire of this stiffness
        weighs, since most other metals are heavier.
        """
        weight, section = self.linear_density, self.section
        if weight is None and self.units == "SI" and self.radius is not None:
            inertia = (self.radius**2 + self.inner_radius**2) / 4
            weight = self.bending_stiffness / (inertia * _SPECIFIC_STIFFNESS)
        if weight is None or self.units != "SI" or (section and not section.weighed):
            return None
        share = 1 / 8
        if section is not None:
            share = sag(section.bending_at, section.linear_density_at, self.breaks)
        return weight * _GRAVITY * self.length**4 * share / self.bending_stiffness
