"""The shape of the rod at rest: curvature and twist along it."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from vibrissa.geometry.checks import finite, finite_array, positive
from vibrissa.rod.centre_line import curvature_along
from vibrissa.rod.section import increasing, kinks
from vibrissa.rod.tree import Described, Figure, array, known, tree

Along = Float[Any, "..."]
Components = Float[Any, "... 3"]

_NEWTON_STEPS = 7  # from the start below: rounding for arc lengths up to 1e12/a

_FITS = 0.05
"""Share of the rod's length by which a table or points may be shorter or longer: a length that was
calibrated stays within, wrong units do not.
"""


class RestShape(Described, ABC):
    """Curvatures u of the unloaded rod: u₁, u₂ about the axes d₁, d₂ of the section and the twist
    u₃ about its tangent d₃, with d_i' = (Σ u_j d_j) × d_i. At the clamp, d₁, d₂, d₃ are the clamp's
    axes x, y, z. A pytree: its values may be JAX numbers.
    """

    @property
    def breaks(self) -> tuple[float, ...]:
        """Fractions of the shape's own extent, between 0 and 1, where u has a kink."""
        return ()

    def check(self, length: float) -> None:
        """Raise ValueError if a table or points do not cover a rod of this length [m]."""

    @abstractmethod
    def at(self, s: ArrayLike) -> Components:
        """U (…, 3) [1/m] at arc lengths (…) [m]; traceable by JAX."""

    @abstractmethod
    def scaled(self, factor: Figure) -> "RestShape":
        """The same shape, larger by a factor."""

    @staticmethod
    def straight() -> "RestShape":
        """No curvature."""
        return Polynomial(np.zeros(0))

    @staticmethod
    def arc(radius: Figure, roll: Figure = 0.0) -> "RestShape":
        """A circular arc of a radius [m] in the plane of clamp +z and e = (cos roll, sin roll, 0),
        bending towards e.

        Raises
        ------
        ValueError
            If the radius is not positive and finite, or the roll not finite.
        """
        radius = positive(radius, "radius") if known(radius) else radius
        return RestShape.polynomial((1 / radius,), roll)

    @staticmethod
    def polynomial(coefficients: ArrayLike, roll: Figure = 0.0) -> "RestShape":
        """Curvature κ = c₀ + c₁ s + … [1/m] in the plane of clamp +z and e = (cos roll, sin roll,
        0): t' = κ e at the clamp.

        Raises
        ------
        ValueError
            If there is no coefficient, or one or the roll is not finite.
        """
        if known(coefficients):
            coefficients = finite_array(coefficients, "coefficients", ndim=1)
            if not len(coefficients):
                raise ValueError("coefficients = []; allowed is at least one number")
        return Polynomial(array(coefficients), _roll(roll))

    @staticmethod
    def parabola(a: Figure, roll: Figure = 0.0) -> "RestShape":
        """The parabola y = a x² [a in 1/m] whose vertex is at the clamp, x along clamp +z and y
        along e = (cos roll, sin roll, 0); κ = 2a/(1 + 4a²x²)^(3/2).

        The shape of rat whiskers (R. B. Towal et al., PLoS Computational Biology 7 (2011) e1001120;
        B. W. Quist, M. J. Z. Hartmann, Journal of Neurophysiology 107 (2012) 2298-2312).

        Raises
        ------
        ValueError
            If a value is not finite.
        """
        return Parabola(finite(a, "a") if known(a) else a, _roll(roll))

    @staticmethod
    def from_components(arc_length: ArrayLike, curvature: ArrayLike) -> "RestShape":
        """A table of u (k, 3) [1/m] at arc lengths (k,) [m] from 0 to the rod's length (to 5 %),
        linear between entries.

        Raises
        ------
        ValueError
            If arc lengths do not increase from 0, or shapes do not fit.
        """
        s, u = increasing(arc_length), finite_array(curvature, "curvature", last=3, ndim=2)
        if len(u) != len(s):
            raise ValueError(f"curvature has shape {u.shape}; allowed is ({len(s)}, 3)")
        kept = kinks(s, u)
        return Table(tuple((s[kept] / s[-1]).tolist()), u[kept], float(s[-1]))

    @staticmethod
    def from_points(points: ArrayLike) -> "RestShape":
        """The curve through points (k, 3) [m] in clamp axes, the first at the clamp, as long as the
        rod (to 5 %): a spline of degree 5 (3 for fewer than six points), without twist.

        The curve is turned so that it leaves along clamp +z, by at most 5°: a tilt of the rod in
        its mount belongs to the clamp's orientation. Curvature amplifies noise of the points:
        smooth measured ones first.

        Raises
        ------
        ValueError
            If there are fewer than four points, two successive ones coincide, the first is not at
            the clamp, or the curve leaves the clamp in another direction.
        """
        s, u = curvature_along(finite_array(points, "points", last=3, ndim=2))
        extent = float(s[-1])
        spline = CubicSpline(s / extent, u)
        return Spline(spline.x, np.moveaxis(spline.c, 0, -1), extent)


def _roll(roll: Figure) -> Figure:
    return finite(roll, "roll") if known(roll) else roll


def _covers(extent: float, length: float, name: str) -> None:
    if abs(extent - length) > _FITS * length:
        raise ValueError(
            f"{name}: {extent:g} long, the rod {length:g}; allowed is the rod's length to 5 %"
        )


def _planar(kappa: Along, roll: Figure) -> Components:
    return kappa[..., None] * jnp.stack([-jnp.sin(roll), jnp.cos(roll), jnp.zeros(())])


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class Polynomial(RestShape):
    """Plane curvature as a polynomial of arc length: see `RestShape.polynomial`."""

    coefficients: Float[Any, "k"]
    roll: Figure = 0.0

    def at(self, s: ArrayLike) -> Components:
        """As in `RestShape`."""
        s = jnp.asarray(s, float)
        kappa = jnp.zeros_like(s)
        for c in jnp.asarray(self.coefficients)[::-1]:
            kappa = kappa * s + c
        return _planar(kappa, self.roll)

    def scaled(self, factor: Figure) -> "Polynomial":
        """As in `RestShape`."""
        powers = 1 + np.arange(len(self.coefficients))
        return Polynomial(jnp.asarray(self.coefficients) / factor**powers, self.roll)


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class Parabola(RestShape):
    """See `RestShape.parabola`."""

    a: Figure
    roll: Figure = 0.0

    def at(self, s: ArrayLike) -> Components:
        """As in `RestShape`: with 2ax = sinh v, the arc length is 4as = sinh v cosh v + v, or sinh
        y + y = 8as for y = 2v.
        """
        whole = 8 * self.a * jnp.asarray(s, float)
        y = jnp.arcsinh(whole / 2)
        for _ in range(_NEWTON_STEPS):
            y = y - (jnp.sinh(y) + y - whole) / (jnp.cosh(y) + 1)
        return _planar(2 * self.a / jnp.cosh(y / 2) ** 3, self.roll)

    def scaled(self, factor: Figure) -> "Parabola":
        """As in `RestShape`."""
        return Parabola(self.a / factor, self.roll)


@tree("knots")
@dataclass(frozen=True, eq=False, repr=False)
class Table(RestShape):
    """Curvatures and twist, linear between fractions of an extent: see
    `RestShape.from_components`.
    """

    knots: tuple[float, ...]
    curvature: Float[Any, "k 3"]
    extent: Figure

    @property
    def breaks(self) -> tuple[float, ...]:
        """As in `RestShape`."""
        return self.knots[1:-1]

    def check(self, length: float) -> None:
        """As in `RestShape`."""
        _covers(self.extent, length, "rest.arc_length")

    def at(self, s: ArrayLike) -> Components:
        """As in `RestShape`; the last values hold beyond the extent."""
        x, knots = jnp.asarray(s) / self.extent, np.array(self.knots)
        u = [jnp.interp(x, knots, column) for column in jnp.asarray(self.curvature).T]
        return jnp.stack(u, axis=-1)

    def scaled(self, factor: Figure) -> "Table":
        """As in `RestShape`."""
        return Table(self.knots, self.curvature / factor, self.extent * factor)


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class Spline(RestShape):
    """Curvatures as a cubic spline with two continuous derivatives: see `RestShape.from_points`."""

    knots: Float[Any, "k"]
    """Fractions of the extent."""
    coefficients: Float[Any, "k_1 3 4"]
    """Of (x − knot)³ to (x − knot)⁰."""
    extent: Figure

    def check(self, length: float) -> None:
        """As in `RestShape`."""
        _covers(self.extent, length, "rest.points")

    def at(self, s: ArrayLike) -> Components:
        """As in `RestShape`; the last values hold beyond the extent."""
        x, knots = jnp.clip(jnp.asarray(s) / self.extent, 0.0, 1.0), jnp.asarray(self.knots)
        cell = jnp.clip(jnp.searchsorted(knots, x, side="right") - 1, 0, len(knots) - 2)
        d, c = (x - knots[cell])[..., None], jnp.asarray(self.coefficients)[cell]
        u: jax.Array = ((c[..., 0] * d + c[..., 1]) * d + c[..., 2]) * d + c[..., 3]
        return u

    def scaled(self, factor: Figure) -> "Spline":
        """As in `RestShape`."""
        return Spline(self.knots, self.coefficients / factor, self.extent * factor)
