"""How the rod changes with temperature."""

from dataclasses import dataclass

from vibrissa.geometry.checks import finite
from vibrissa.rod.tree import Described, Figure, known, tree

ABSOLUTE_ZERO = -273.15
"""[°C]"""


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class Thermal(Described):
    """Linear in the temperature.

    Attributes
    ----------
    modulus_slope
        Change of Young's modulus, relative [1/K].
    expansion
        Of length and radius, relative [1/K].
    reference
        Temperature at which the rod is as it is described [°C].

    Raises
    ------
    ValueError
        If a value is not finite, or the reference below absolute zero.
    """

    modulus_slope: Figure = 0.0
    expansion: Figure = 0.0
    reference: Figure = 20.0

    def __post_init__(self) -> None:
        for name in ("modulus_slope", "expansion", "reference"):
            if known(value := getattr(self, name)):
                object.__setattr__(self, name, finite(value, name))
        _above_zero(self.reference, "reference")

    def factors(self, temperature: Figure) -> tuple[Figure, Figure]:
        """Young's modulus and lengths at a temperature [°C], relative to the reference.

        Raises
        ------
        ValueError
            If one is not positive there, or the temperature is below absolute zero.
        """
        _above_zero(temperature, "temperature")
        rise = (finite(temperature, "temperature") if known(temperature) else temperature) - (
            self.reference
        )
        found = 1 + self.modulus_slope * rise, 1 + self.expansion * rise
        for factor, slope, what in (
            (found[0], self.modulus_slope, "Young's modulus"),
            (found[1], self.expansion, "the length"),
        ):
            if known(factor) and factor <= 0:
                side = "above" if slope > 0 else "below"
                raise ValueError(
                    f"temperature = {temperature!r}: {what} would be {factor:.3g} of that at "
                    f"{self.reference:g} °C; allowed is {side} {self.reference - 1 / slope:g} °C"
                )
        return found

    def at(self, temperature: Figure) -> "Thermal":
        """The same dependence with the temperature as reference."""
        modulus, stretch = self.factors(temperature)
        return Thermal(self.modulus_slope / modulus, self.expansion / stretch, temperature)


def _above_zero(temperature: Figure, name: str) -> None:
    if known(temperature) and finite(temperature, name) < ABSOLUTE_ZERO:
        raise ValueError(f"{name} = {temperature!r}; allowed is at least {ABSOLUTE_ZERO} °C")
