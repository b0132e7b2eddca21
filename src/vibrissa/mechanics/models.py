"""The model of a rod: the closed form where the rod allows it, else the spatial rod."""

from itertools import pairwise
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.hanging import Load
from vibrissa.mechanics.kirchhoff import STEPS, Kirchhoff
from vibrissa.mechanics.model import RodModel
from vibrissa.numerics.compiled import compiled
from vibrissa.rod import Rod
from vibrissa.rod.tree import known

Vector = Float[Any, "3"]

_FINE = 4097
"""Places at which the thickness is looked at."""
_SHARED = 6
"""Numbers of steps are multiples of it: rods with as many steps share compiled code."""
_PER_EFOLD = 0.5
"""Steps for each e-fold of thickness, as a share of those over the length: under the same moment a
thinner part bends more.
"""
_ROUNDING = 1e-9
_THINNEST = 1e-4
"""Thickness below which it does not count as thinner: such a tip carries no force."""


class _Load(Load):
    """A rod's loads in its own units."""

    loads: Any
    length: Any
    unit: Any
    """EI/L³ [N/m]."""

    @property
    def alike_everywhere(self) -> bool:
        """As in `vibrissa.mechanics.hanging.Load`."""
        alike: bool = self.loads.alike_everywhere
        return alike

    @property
    def given(self) -> bool:
        """As in `vibrissa.mechanics.hanging.Load`."""
        given: bool = self.loads.weight_alone
        return given

    def per_length(self, s: Any, position: Vector, tangent: Vector, section: Any) -> Vector:
        """As in `vibrissa.mechanics.hanging.Load`."""
        density, radius = section
        force: Float[Array, "3"] = self.loads.per_length(
            s * self.length,
            position * self.length,
            tangent,
            radius=radius,
            linear_density=density,
        )
        return force / self.unit


def model_of(rod: Rod, steps: int = STEPS) -> RodModel:
    """How a rod bends, in its own units."""
    return Elastica() if rod.plain else spatial(rod, steps)


def spatial(rod: Rod, steps: int = STEPS, nodes: Float[Any, "nodes"] | None = None) -> Kirchhoff:
    """A rod as the spatial model, also where the closed form would do; with given nodes, which a
    traced rod does not show.
    """
    check_thick(rod)
    places = jnp.asarray(nodes_of(rod, steps) if nodes is None else nodes)
    return (_compiled if known(rod, places) else _spatial)(rod, places)


def _spatial(rod: Rod, nodes: Float[Any, "nodes"]) -> Kirchhoff:
    length, rest, loads = rod.length, rod.rest, rod.loads

    def curvature(x: Any) -> Any:
        assert rest is not None
        return rest.at(x * length) * length

    def carried(x: Any) -> Any:
        def of(value: Any) -> Any:
            return None if value is None else value(x)

        return (
            of(rod.linear_density_at if rod.linear_density is not None else None),
            of(rod.radius_at if rod.radius is not None else None),
        )

    load, loaded = None, None
    if loads is not None:
        load, loaded = _Load(loads, length, rod.force_scale / length), carried
    compliance = None
    if rod.support is not None:
        units = np.repeat([1.0, 1.0], 3)
        scale = jnp.concatenate([jnp.full(3, rod.force_scale), jnp.full(3, rod.moment_scale)])
        lengths = jnp.concatenate([jnp.full(3, 1 / length), jnp.ones(3)])
        compliance = lengths[:, None] * jnp.asarray(rod.support.compliance) * scale * units
    return Kirchhoff.of(
        rod.bending_at,
        rod.torsion_at,
        None if rest is None else curvature,
        nodes,
        loaded=loaded,
        girth=None
        if rod.uniform or rod.radius is None
        else lambda x: rod.radius_at(x) / rod.radius,
        load=load,
        compliance=compliance,
    )


# XLA's options cannot be set within other compiled code.
_compiled = compiled(_spatial, quick=True)


def check_thick(rod: Rod) -> None:
    """Raise ValueError where a rod has no thickness, as at the tip of a cone."""
    knots = np.array([0.0, *rod.breaks, 1.0])
    if not known(rod.bending_at(knots)):
        return
    thickness = np.asarray(rod.bending_at(knots)) ** 0.25
    for x, share in zip(knots, thickness, strict=True):
        if share < _THINNEST * (1 - _ROUNDING):
            where = "its tip" if x == 1 else f"{x:g} of its length"
            raise ValueError(
                f"rod: at {where} the rod is {share:g} times as thick as at its clamp, "
                f"and bears no contact; allowed is at least {_THINNEST:g}"
            )


def nodes_of(rod: Rod, steps: int = STEPS) -> Any:
    """Where steps begin and end: at every kink of a table, `steps` over the length and
    `_PER_EFOLD` of them more for each e-fold of thickness, where it changes.
    """
    if rod.section is None or not known(rod.bending_at(np.ones(()))):
        return np.linspace(0, 1, steps + 1)
    s = np.linspace(0, 1, _FINE)
    thickness = np.asarray(rod.bending_at(s)) ** 0.25
    efolds = abs(np.diff(np.log(np.maximum(thickness, _THINNEST))))
    work = np.append(0.0, np.cumsum(steps * np.diff(s) + _PER_EFOLD * steps * efolds))
    work *= np.ceil(work[-1] / _SHARED) * _SHARED / work[-1]
    ends = [0.0, *rod.breaks, 1.0]
    parts = [np.zeros(1)]
    for first, last in pairwise(ends):
        done, due = np.interp((first, last), s, work)
        count = max(1, int(np.ceil(due - done - _ROUNDING)))
        inner = np.interp(np.linspace(done, due, count + 1)[1:-1], work, s)
        parts += [inner, np.array([last])]
    return np.concatenate(parts)
