"""The model of a rod: the closed form where the rod allows it, else the spatial rod."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from vibrissa.mechanics.elastica import Elastica
from vibrissa.mechanics.kirchhoff import STEPS, Kirchhoff, Load, graded
from vibrissa.mechanics.model import RodModel
from vibrissa.rod import Rod

Vector = Float[Any, "3"]


class _Load(Load):
    """A rod's loads in its own units."""

    loads: Any
    length: Any
    unit: Any
    """EI/L³ [N/m]."""

    def per_length(self, s: Any, position: Vector, tangent: Vector, section: Any) -> Vector:
        """As in `vibrissa.mechanics.kirchhoff.Load`."""
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


def spatial(rod: Rod, steps: int = STEPS) -> Kirchhoff:
    """A rod as the spatial model, also where the closed form would do."""
    length, nodes = rod.length, _nodes(rod, steps)
    rest, loads = rod.rest, rod.loads

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
        girth=None if rod.uniform or rod.radius is None else rod.radius_at(nodes) / rod.radius,
        load=load,
        compliance=compliance,
    )


def _nodes(rod: Rod, steps: int) -> Any:
    """Where steps begin and end: at every kink of a table, and closer where the rod is thin."""
    breaks = [0.0, *rod.breaks, 1.0]
    if len(breaks) == 2:
        tip = rod.bending_at(jnp.ones(())) ** 0.25
        return graded(1 - tip, steps)
    thickness = np.asarray(rod.bending_at(np.array(breaks))) ** 0.25
    spans = np.diff(breaks) / np.maximum(np.minimum(thickness[1:], thickness[:-1]), 1e-3)
    counts = np.maximum(1, np.rint(steps * spans / spans.sum())).astype(int)
    parts = [
        np.linspace(first, last, count, endpoint=False)
        for first, last, count in zip(breaks, breaks[1:], counts, strict=False)
    ]
    return np.append(np.concatenate(parts), 1.0)
