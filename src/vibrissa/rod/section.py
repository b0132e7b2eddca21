"""How the section varies along a rod: a taper, or a table."""

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.geometry.checks import finite, finite_array
from vibrissa.rod.tree import Described, Figure, array, known, tree

Values = Float[Any, "k"]
Along = Float[Any, "..."]

_ONE = 1e-9  # rounding of a column that was divided by its first entry, or printed
_RELATIVE = "the column is relative to the value at the clamp"
_GIVEN = "allowed is a section given by radius, with or without bore, or by bending"
_COLLINEAR = 1e-12
"""Share of a column's largest value within which an entry lies on the line through its neighbours:
the rounding of a table that was split finer.
"""


@tree("knots")
@dataclass(frozen=True, eq=False, repr=False)
class Section(Described):
    """Radius, stiffness and mass along a rod relative to those at the clamp, linear between knots.

    A pytree: its values may be JAX numbers. A round section is given by `radius` and `bore`; any
    other by `bending` and `torsion`, which then take precedence.

    Attributes
    ----------
    knots
        (k,) places as fractions of the length, from 0 to 1, increasing; between the first and the
        last, those where a value has a kink.
    radius
        (k,) outer radius [outer radius at the clamp]; 1 at the clamp.
    bore
        (k,) inner radius of a hollow rod [outer radius at the clamp].
    bending, torsion
        (k,) EI and GJ [EI at the clamp].
    linear_density
        (k,) mass per length [that at the clamp], if it is not that of the section of one material.

    Raises
    ------
    ValueError
        If neither radius nor bending is given, or a bore without a radius; if knots do not increase
        from 0 to 1; if a column has another length or an entry out of range, or does not begin with
        1 where it is relative to its own value at the clamp.
    """

    knots: tuple[float, ...]
    radius: Values | None = None
    bore: Values | None = None
    bending: Values | None = None
    torsion: Values | None = None
    linear_density: Values | None = None

    def __post_init__(self) -> None:
        knots = increasing(self.knots, "knots").tolist()
        if knots[-1] != 1:
            raise ValueError(f"knots[{len(knots) - 1}] = {knots[-1]}; allowed is 1: the tip")
        object.__setattr__(self, "knots", tuple(knots))
        if self.radius is None and (self.bending is None or self.bore is not None):
            needs = "bending" if self.bore is None else "bore"
            raise ValueError(f"radius = None, {needs} = {getattr(self, needs)!r}; {_GIVEN}")
        for name in ("radius", "bending", "torsion", "linear_density"):
            if (values := getattr(self, name)) is not None and known(values):
                values = column(values, name, len(knots))
                if name != "torsion" and abs(values[0] - 1) > _ONE:
                    raise ValueError(f"{name}[0] = {values[0]}; allowed is 1: {_RELATIVE}")
                object.__setattr__(self, name, values)
        if self.bore is not None and known(self.bore, self.radius):
            bore = finite_array(self.bore, "bore", last=len(knots), ndim=1)
            check_within(bore, np.asarray(self.radius), "bore", "radius")
            object.__setattr__(self, "bore", bore)

    @classmethod
    def taper(cls, taper: Figure) -> "Section":
        """A round solid rod whose radius falls linearly, by the fraction `taper` at its tip: EI =
        (1 − τ x)⁴; 1 is a cone.

        Raises
        ------
        ValueError
            If the taper exceeds 1 or is not finite.
        """
        if known(taper) and not finite(taper, "taper") <= 1:
            raise ValueError(f"taper = {taper!r}; allowed is a finite number of at most 1")
        return cls((0.0, 1.0), radius=array((1.0, 1.0 - taper)))

    @classmethod
    def table(cls, place: ArrayLike, **columns: ArrayLike | None) -> "Section | None":
        """From entries (k,) at increasing fractions; None for a round section that does not vary.

        Entries on the line between their neighbours are left out: all inner knots are kinks.
        """
        at = increasing(place, "knots")
        given = {name: np.asarray(c, float) for name, c in columns.items() if c is not None}
        cls(tuple(at.tolist()), **given)  # checks what is left out below
        stacked = np.stack(list(given.values()), axis=-1)
        if "bending" not in given and np.all(stacked == stacked[0]):
            return None
        kept = kinks(at, stacked)
        return cls(tuple(at[kept].tolist()), **{name: part[kept] for name, part in given.items()})

    @property
    def breaks(self) -> tuple[float, ...]:
        """Fractions between 0 and 1 where a value has a kink."""
        return self.knots[1:-1]

    @property
    def weighed(self) -> bool:
        """Whether mass along the rod is known relative to that at the clamp."""
        return self.bending is None or self.linear_density is not None

    def bending_at(self, x: ArrayLike) -> Along:
        """EI [EI at the clamp] at fractions of the length; any shape."""
        if self.bending is not None:
            return self._at(self.bending, x)
        return self._moment(x, 4)

    def torsion_at(self, x: ArrayLike, poisson_ratio: Figure) -> Along:
        """GJ [EI at the clamp]: EI/(1 + ν) for a round section."""
        if self.torsion is not None:
            return self._at(self.torsion, x)
        return self.bending_at(x) / (1 + poisson_ratio)

    def radius_at(self, x: ArrayLike) -> Along:
        """Outer radius [that at the clamp].

        Raises
        ------
        ValueError
            If only stiffness is known.
        """
        if self.radius is None:
            raise ValueError("radius = None: the table of this rod needs a column radius")
        return self._at(self.radius, x)

    def linear_density_at(self, x: ArrayLike) -> Along:
        """Mass per length [that at the clamp].

        Raises
        ------
        ValueError
            If neither it nor the radius is known.
        """
        if self.linear_density is not None:
            return self._at(self.linear_density, x)
        if not self.weighed:
            raise ValueError(
                "linear_density = None: the table of this rod needs a column linear_density"
            )
        return self._moment(x, 2)

    def _moment(self, x: ArrayLike, power: int) -> Along:
        """Powers of the outer less those of the inner radius, relative to the clamp's."""
        if self.bore is None:
            return self._at(self.radius, x) ** power
        outer, inner = self._at(self.radius, x), self._at(self.bore, x)
        return (outer**power - inner**power) / (1 - self.bore[0] ** power)

    def _at(self, values: Any, x: ArrayLike) -> Along:
        # NumPy compiles nothing.
        xp: Any = np if known(values, x) else jnp
        return xp.interp(xp.asarray(x), np.array(self.knots), xp.asarray(values))


def kinks(place: Float[np.ndarray, "k"], columns: Float[np.ndarray, "k c"]) -> list[int]:
    """Entries that a piecewise linear table (k, columns) needs: both ends, and the kinks."""
    allowed = _COLLINEAR * np.abs(columns).max(axis=0)
    kept = [0]
    for at in range(1, len(place) - 1):
        before = kept[-1]
        share = (place[at] - place[before]) / (place[at + 1] - place[before])
        line = columns[before] + share * (columns[at + 1] - columns[before])
        if np.any(np.abs(columns[at] - line) > allowed):
            kept.append(at)
    return [*kept, len(place) - 1]


def increasing(values: ArrayLike, name: str = "arc_length") -> Float[np.ndarray, "k"]:
    """Arc lengths of a table (k,), or its knots, as an array.

    Raises
    ------
    ValueError
        If there are fewer than two, the first is not 0, or they do not increase.
    """
    s = finite_array(values, name, ndim=1)
    if len(s) < 2 or s[0] != 0:
        raise ValueError(f"{name} = {s.tolist()}; allowed are at least two numbers, the first 0")
    steps = np.diff(s)
    if not np.all(steps > 0):
        at = int(np.argmax(steps <= 0)) + 1
        raise ValueError(
            f"{name}[{at}] = {s[at]}; allowed is a number greater than {s[at - 1]}: "
            "they increase along the rod"
        )
    return s


def column(values: ArrayLike, name: str, count: int) -> Float[np.ndarray, "k"]:
    """A column of positive numbers (k,) from clamp to tip; the last may be 0.

    Raises
    ------
    ValueError
        If it has another length, or an entry is not positive and finite.
    """
    found = finite_array(values, name, last=count, ndim=1)
    for at, value in enumerate(found.tolist()):
        last = at == count - 1
        if value < 0 or (value == 0 and not last):
            allowed = "a number of at least 0" if last else "a number greater than 0"
            raise ValueError(f"{name}[{at}] = {value}; allowed is {allowed}")
    return found


def check_within(
    inner: Float[np.ndarray, "k"], outer: Float[np.ndarray, "k"], name: str, around: str
) -> None:
    """Raise ValueError unless each inner radius is at least 0 and below the outer one, or both are
    0.
    """
    for at, (bore, whole) in enumerate(zip(inner.tolist(), outer.tolist(), strict=True)):
        if bore < 0 or (bore >= whole and bore > 0):
            raise ValueError(
                f"{name}[{at}] = {bore}; allowed is a number of at least 0 and below "
                f"{around}[{at}] = {whole}"
            )
