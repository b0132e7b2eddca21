"""What a sweep says about its setup: the findings."""

from dataclasses import dataclass

from vibrissa.brief import brief
from vibrissa.inverse.arrays import Flags, Vectors
from vibrissa.rod import Rod


@dataclass(frozen=True)
class Cause:
    """How large one cause of error would have to be to explain a sweep's misfit.

    Attributes
    ----------
    name, unit
        Such as `bending_stiffness`, relative ("1").
    estimate, deviation
        One number or several: true minus stated value, and its standard deviation.
    significance
        Of the misfit that it explains, in standard deviations.
    explained
        Fraction of the misfit that it explains.
    shift
        Median shift of the contacts that it implies, in units of the rod.
    """

    name: str
    unit: str
    estimate: tuple[float, ...]
    deviation: tuple[float, ...]
    significance: float
    explained: float
    shift: float


@dataclass(frozen=True, eq=False)
class SetupCheck:
    """What a sweep says about its setup.

    Attributes
    ----------
    causes
        Each cause by itself, those that explain most first. They are candidates: several may
        explain the same misfit.
    reduced_chi_square
        Mean square of the constraints' residuals, relative to the noise; 1 if all is as stated.
    friction
        Coefficient that tangential contacts show if all else is as stated, or the one given.
    apart
        (…) whether a row fits no single contact while all others agree with the setup, as where the
        rod touches in two places.
    named
        Names of causes that explain about the same, one tuple per warning.
    warnings
        One line each.
    shift
        (…, 3) how far contacts are off if the likeliest causes are right, the largest of those
        named together; units of the rod, world axes; 0 if none is named.
    misread
        Whether the numbers contradict each other as a whole, as with wrong units, signs or axes, so
        that no contact can be trusted.
    note
        Why the setup is not checked, where it could be but for its rod; else empty.
    """

    shift: Vectors
    friction: float
    apart: Flags
    causes: tuple[Cause, ...] = ()
    reduced_chi_square: float = 1.0
    named: tuple[tuple[str, ...], ...] = ()
    warnings: tuple[str, ...] = ()
    misread: bool = False
    note: str = ""

    __repr__ = brief


def length_text(value: float, rod: Rod) -> str:
    """A length as worded in a sentence, without its sign."""
    return f"{1e3 * abs(value):.2g} mm" if rod.units == "SI" else f"{abs(value):.2g} L"
