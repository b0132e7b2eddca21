"""What a calibration may change about a rod's form: taper, constant rest curvature, and how it
pivots.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from vibrissa.mechanics.models import nodes_of
from vibrissa.rod import RestShape, Rod, Section, Support
from vibrissa.rod.rest_shape import Polynomial
from vibrissa.rod.tree import Figure, tree

TAPER = ("taper", "tip_radius")
REST = ("rest_curvature", "rest_roll")
SUPPORT = "support_stiffness"
NAMES = (*TAPER, *REST, SUPPORT)


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class _Arc(RestShape):
    """A constant curvature towards the clamp's x and y axes, which is smooth where the rod is
    straight.
    """

    curvature: Float[Any, "2"]

    def at(self, s: ArrayLike) -> Float[Any, "... 3"]:
        """As in `RestShape`."""
        u = jnp.stack([-self.curvature[1], self.curvature[0], jnp.zeros(())])
        return jnp.ones_like(jnp.asarray(s, float))[..., None] * u

    def scaled(self, factor: Figure) -> "_Arc":
        """As in `RestShape`."""
        return _Arc(self.curvature / factor)


class Form(NamedTuple):
    """A rod for the spatial model, and where its steps begin and end."""

    rod: Rod
    nodes: Float[Any, "nodes"]


class Shape(NamedTuple):
    """Numbers of a rod's form; what a rod does not have is 0."""

    taper: Float[Any, ""]
    """Fraction by which the radius is smaller at the tip."""
    rest: Float[Any, "2"]
    """Curvature at rest towards the clamp's x and y axes."""
    roll: Float[Any, ""]
    """Of the direction in which the rod is given to be bent."""
    support: Float[Any, "3"]
    """Stiffnesses of a pivot about the clamp's axes."""

    @property
    def polar(self) -> Float[np.ndarray, "2"]:
        """Curvature and roll; the curvature is negative where the rod is bent straight against the
        given direction.
        """
        along, across = self.turn.T @ self.rest
        if across == 0:
            return np.array([along, self.roll])
        return np.array([np.hypot(along, across), self.roll + np.arctan2(across, along)])

    @property
    def turn(self) -> Float[np.ndarray, "2 2"]:
        """From along and across the given direction to clamp axes."""
        cosine, sine = np.cos(self.roll), np.sin(self.roll)
        return np.array([[cosine, -sine], [sine, cosine]])

    def moved(self, taper: Any, rest: Any, support: Any) -> "Shape":
        """After steps, each of which may be left out."""
        if not taper.size:
            return self
        cosine, sine = jnp.cos(self.roll), jnp.sin(self.roll)
        turned = jnp.stack([cosine * rest[0] - sine * rest[1], sine * rest[0] + cosine * rest[1]])
        return self._replace(
            taper=self.taper + taper[0],
            rest=self.rest + turned,
            support=self.support * jnp.exp(support),
        )

    def applied(self, rod: Rod) -> Rod:
        """A rod of `Form` with these numbers, which may be traced."""
        section, rest, support = rod.section, rod.rest, rod.support
        if section is not None and _tapers(rod):
            section = replace(section, radius=jnp.stack([jnp.ones(()), 1 - self.taper]))
        if isinstance(rest, _Arc):
            rest = _Arc(self.rest)
        if _pivots(rod):
            support = Support("pivot", self.support)
        return replace(rod, section=section, rest=rest, support=support)


def form_of(rod: Rod, names: tuple[str, ...]) -> Form | None:
    """The rod in a form that may change; None where it is plain and nothing of that is free.

    Raises
    ------
    ValueError
        If the rod does not have what is to be free.
    """
    _check(rod, names)
    if rod.plain and not set(names) & set(NAMES):
        return None
    whole = rod
    if _tapers(rod) and rod.section is None:
        whole = replace(whole, section=_tapered(rod, 0.0))
    if _bends(rod):
        whole = replace(whole, rest=_Arc(np.zeros(2)))
    return Form(whole, np.asarray(nodes_of(rod)))


def _check(rod: Rod, names: tuple[str, ...]) -> None:
    for name in names:
        if name in TAPER and not _tapers(rod):
            raise ValueError(
                f"free: {name!r} needs a rod that is uniform or tapers linearly; this one is given "
                "by a table"
            )
        if name in REST and not _bends(rod):
            raise ValueError(
                f"free: {name!r} needs a rod that is straight or an arc at rest; the rest shape of "
                "this one is another"
            )
        if name == SUPPORT and not _pivots(rod):
            kind = "rigid" if rod.support is None else rod.support.kind
            raise ValueError(
                f"free: {name!r} needs a rod on a pivot (Support.pivot); the support is {kind}"
            )
    if "rest_roll" in names and "rest_curvature" not in names:
        raise ValueError(
            "free: 'rest_roll' needs 'rest_curvature'; to turn a rod of known curvature, free "
            "clamp_orientation"
        )


def shape_of(rod: Rod) -> Shape:
    """The numbers as a rod has them."""
    taper, rest, roll, support = 0.0, np.zeros(2), 0.0, np.zeros(3)
    if _tapers(rod) and rod.section is not None:
        taper = 1 - float(np.asarray(rod.section.radius)[1])
    if _bends(rod) and rod.rest is not None:
        assert isinstance(rod.rest, Polynomial)
        roll = float(rod.rest.roll)
        direction = np.array([np.cos(roll), np.sin(roll)])
        rest = float(np.asarray(rod.rest.coefficients)[0]) * direction
    if _pivots(rod):
        assert rod.support is not None
        support = np.asarray(rod.support.stiffness, dtype=float)
    return Shape(np.asarray(taper), rest, np.asarray(roll), support)


def adjusted(rod: Rod, shape: Shape) -> Rod:
    """The rod with these numbers, where they differ from its own."""
    own = shape_of(rod)
    if shape.taper != own.taper:
        rod = replace(rod, section=_tapered(rod, float(shape.taper)))
    if np.any(np.asarray(shape.rest) != own.rest):
        curvature, roll = shape.polar.tolist()
        rod = replace(rod, rest=RestShape.polynomial((curvature,), roll))
    if np.any(np.asarray(shape.support) != own.support):
        rod = replace(rod, support=Support.pivot(np.asarray(shape.support)))
    return rod


def _tapered(rod: Rod, taper: float) -> Section:
    plain = Section.taper(taper)
    if rod.section is not None:
        return replace(rod.section, radius=plain.radius)
    bore = None
    if rod.inner_radius and rod.radius is not None:
        bore = np.full(2, rod.inner_radius / rod.radius)
    return replace(plain, bore=bore)


def _tapers(rod: Rod) -> bool:
    """Whether the radius is the same or changes linearly all along."""
    section = rod.section
    return section is None or (
        section.knots == (0.0, 1.0) and section.bending is None and section.linear_density is None
    )


def _bends(rod: Rod) -> bool:
    """Whether the curvature at rest is the same all along, or nothing."""
    rest = rod.rest
    return rest is None or (isinstance(rest, Polynomial) and len(rest.coefficients) == 1)


def _pivots(rod: Rod) -> bool:
    return rod.support is not None and rod.support.kind == "pivot"
