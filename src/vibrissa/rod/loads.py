"""What acts on the rod along its length: weight, wind, and any other force per length."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from vibrissa.geometry.checks import finite_array, positive
from vibrissa.rod.tree import Described, Figure, known, tree

Vector = Float[Any, "3"]

_SLOWEST = 1e-4
"""Reynolds number from which the drag law holds; below it, drag is made linear in the velocity."""


@tree()
@dataclass(frozen=True, eq=False, repr=False)
class Loads(Described):
    """Forces per length on the rod, in world axes.

    A pytree: its values may be JAX numbers.

    Attributes
    ----------
    gravity
        Acceleration (3,) [m/s²]; needs the rod's density.
    wind
        Velocity (3,) [m/s] of the fluid relative to the rod, or a function of a position (3,) [m]
        that returns it, traceable by JAX; needs the rod's radius.
    fluid_density
        [kg/m³]; that of air at 20 °C by default.
    viscosity
        Dynamic [Pa s]; that of air at 20 °C by default.
    force
        Any other: a function of arc length [m], position (3,) [m] and tangent (3,) that returns
        (3,) [N/m], traceable by JAX.

    Raises
    ------
    ValueError
        If a number is not finite, fluid density or viscosity is not positive, or a function cannot
        be traced by JAX or does not return three numbers.
    """

    gravity: Vector | tuple[float, ...] | None = None
    wind: Vector | tuple[float, ...] | Callable[..., Any] | None = None
    fluid_density: Figure = 1.204
    viscosity: Figure = 1.825e-5
    force: Callable[..., Any] | None = None

    def __post_init__(self) -> None:
        for name in ("gravity", "wind"):
            value = getattr(self, name)
            if value is not None and not callable(value) and known(value):
                entries = finite_array(value, name, last=3, ndim=1)
                object.__setattr__(self, name, tuple((entries + 0.0).tolist()))
        for name in ("fluid_density", "viscosity"):
            if known(value := getattr(self, name)):
                object.__setattr__(self, name, positive(value, name))
        if callable(self.wind):
            _check(self.wind, "wind", jnp.zeros(3))
        if self.force is not None:
            _check(self.force, "force", jnp.zeros(()), jnp.zeros(3), jnp.array([0.0, 0.0, 1.0]))

    @property
    def none(self) -> bool:
        """Whether nothing acts."""
        return self.gravity is None and self.wind is None and self.force is None

    @property
    def alike_everywhere(self) -> bool:
        """Whether no function of the position acts."""
        return self.force is None and not callable(self.wind)

    @property
    def weight_alone(self) -> bool:
        """Whether nothing else acts."""
        return self.force is None and self.wind is None

    def per_length(
        self,
        arc_length: Figure,
        position: Vector,
        tangent: Vector,
        *,
        radius: Figure | None,
        linear_density: Figure | None,
    ) -> Vector:
        """Force per length (3,) [N/m] on the rod at a place, in world axes.

        Parameters
        ----------
        arc_length, position, tangent
            Of the place [m], (3,) [m], (3,).
        radius
            Of the rod there [m]; for wind.
        linear_density
            Of the rod there [kg/m]; for gravity.
        """
        total = jnp.zeros(3)
        if self.gravity is not None:
            total = total + jnp.asarray(linear_density) * jnp.asarray(self.gravity)
        if self.wind is not None:
            wind = self.wind(position) if callable(self.wind) else jnp.asarray(self.wind)
            total = total + self.drag(wind, tangent, radius)
        if self.force is not None:
            total = total + self.force(arc_length, position, tangent)
        return total

    def check_finite(
        self,
        arc_length: Float[np.ndarray, "n"],
        position: Float[np.ndarray, "n 3"],
        tangent: Float[np.ndarray, "n 3"],
    ) -> None:
        """Raise ValueError if a function gives no finite numbers at one of these places."""
        places = {"wind": (position,), "force": (arc_length, position, tangent)}
        for name, given in places.items():
            function = getattr(self, name)
            if not callable(function):
                continue
            for at, values in enumerate(zip(*given, strict=True)):
                found = np.asarray(function(*map(jnp.asarray, values)))
                if not np.isfinite(found).all():
                    raise ValueError(
                        f"{name}: {function!r} returns {found.tolist()} at the position "
                        f"{position[at].tolist()} on the rod; allowed are finite numbers"
                    )

    def drag(self, wind: Vector, tangent: Vector, radius: Any) -> Vector:
        """Drag (3,) [N/m] on a long cylinder: only the velocity v across it counts (the principle
        of independence; S. F. Hoerner, Fluid-Dynamic Drag, 1965, ch. 3), ρ r C_D ‖v‖ v.

        C_D = 1.18 + 6.8/Re^0.89 + 1.96/Re^0.5 − 0.0004 Re/(1 + 3.64e-7 Re²), 1e-4 < Re < 2e5 (D.
        Sucker, H. Brauer, Wärme- und Stoffübertragung 8 (1975) 149-158), as μ C_D Re v/2, which is
        smooth where the fluid rests.
        """
        across = wind - jnp.dot(wind, tangent) * tangent
        per_speed = 2 * radius * self.fluid_density / self.viscosity
        re = jnp.sqrt(per_speed**2 * jnp.dot(across, across) + _SLOWEST**2)
        times_re = 1.18 * re + 6.8 * re**0.11 + 1.96 * jnp.sqrt(re)
        times_re = times_re - 0.0004 * re**2 / (1 + 3.64e-7 * re**2)
        return self.viscosity / 2 * times_re * across


def _check(function: Callable[..., Any], name: str, *arguments: jax.Array) -> None:
    """Raise ValueError unless JAX can trace the function to three real numbers."""
    try:
        shape = jax.eval_shape(lambda *given: jnp.asarray(function(*given)), *arguments)
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(
            f"{name}: {function!r} cannot be traced by JAX ({reason}); allowed is a function of "
            "jax.numpy operations"
        ) from error
    if shape.shape != (3,) or not jnp.issubdtype(shape.dtype, jnp.floating):
        raise ValueError(
            f"{name}: {function!r} returns {shape.dtype} of shape {shape.shape}; allowed are three "
            "real numbers: shape (3,)"
        )
