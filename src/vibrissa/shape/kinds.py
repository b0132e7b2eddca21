"""Primitives by their sizes, in axes of their own.

Axial ones have the z axis; a cone has its apex at the origin, so that its side alone determines
where it is.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from vibrissa.numerics.lanes import lanes
from vibrissa.shape.poses import Poses, Told
from vibrissa.shape.sites import Gathered
from vibrissa.surfaces import Box, Cone, Cylinder, Ellipsoid, Plane, Sphere, Surface, Torus

_Z = (0.0, 0.0, 1.0)
_O = (0.0, 0.0, 0.0)


class Shaped(NamedTuple):
    """Poses with the logarithms of sizes."""

    turn: Float[np.ndarray, "k 3 3"]
    shift: Float[np.ndarray, "k 3"]
    sizes: Float[np.ndarray, "k s"]

    def moved(self, step: Float[np.ndarray, "k u"], middle: Float[np.ndarray, "3"]) -> "Shaped":
        """Each turned about a point and shifted, sizes multiplied by at most a factor of two."""
        poses = Poses(self.turn, self.shift).moved(step[:, :6], middle)
        return Shaped(*poses, self.sizes + np.clip(step[:, 6:], -0.7, 0.7))

    def part(self, rows: Any) -> "Shaped":
        """Some of them."""
        return Shaped(*(values[rows].copy() for values in self))


class Kind(NamedTuple):
    """A class of primitives: names of sizes and axis, how many unknowns contacts
    could determine, and how it is built from its sizes.
    """

    names: tuple[str, ...]
    axis: str
    """Name of the direction of the z axis, if that is a parameter."""
    known: int
    template: Surface
    filled: Callable[[Any, Any], Any]
    """A copy of the template with given sizes, in its own axes."""
    surface: Callable[..., Surface]
    """The object at a pose, from rotation matrix, shift and logarithms of sizes."""
    ends: tuple[tuple[int, Float[np.ndarray, "3"]], ...] = ()
    """Sizes that only say where faces end, and how the middle moves by how much they grow, so that
    one end stays.
    """


def _put(*names: str) -> Callable[[Any, Any], Any]:
    """Sizes in their order as fields of a surface."""

    def filled(template: Any, sizes: Any) -> Any:
        return eqx.tree_at(
            lambda solid: [getattr(solid, name) for name in names], template, list(sizes)
        )

    return filled


def _three(name: str) -> Callable[[Any, Any], Any]:
    """Three sizes as one field."""
    return lambda template, sizes: eqx.tree_at(
        lambda solid: getattr(solid, name), template, jnp.stack([sizes[0], sizes[1], sizes[2]])
    )


def _cone(template: Any, sizes: Any) -> Any:
    angle, height = sizes[0], sizes[1]
    center = jnp.stack([0.0 * height, 0.0 * height, -height])
    return eqx.tree_at(
        lambda cone: [cone.center, cone.radius, cone.height],
        template,
        [center, height * jnp.tan(angle), height],
    )


_KINDS: dict[type[Surface], Kind] = {
    Plane: Kind(
        (),
        "normal",
        3,
        Plane(_O, _Z),
        lambda template, _: template,
        lambda turn, shift, _: Plane(shift, turn[:, 2]),
    ),
    Sphere: Kind(
        ("radius",),
        "",
        4,
        Sphere(_O, 1.0),
        _put("radius"),
        lambda _, shift, sizes: Sphere(shift, *np.exp(sizes)),
    ),
    Cylinder: Kind(
        ("radius", "length"),
        "axis",
        5,
        Cylinder(_O, _Z, 1.0, 1.0),
        _put("radius", "length"),
        lambda turn, shift, sizes: Cylinder(shift, turn[:, 2], *np.exp(sizes)),
        ((1, np.array([0.0, 0.0, 0.5])),),
    ),
    Cone: Kind(
        ("half_angle", "height"),
        "axis",
        6,
        Cone(_O, _Z, 1.0, 1.0),
        _cone,
        lambda turn, shift, sizes: Cone(
            shift - np.exp(sizes[1]) * turn[:, 2],
            turn[:, 2],
            np.exp(sizes[1]) * np.tan(np.exp(sizes[0])),
            np.exp(sizes[1]),
        ),
        ((1, np.zeros(3)),),
    ),
    Torus: Kind(
        ("major_radius", "minor_radius"),
        "axis",
        7,
        Torus(_O, _Z, 2.0, 1.0),
        _put("major_radius", "minor_radius"),
        lambda turn, shift, sizes: Torus(shift, turn[:, 2], *np.exp(sizes)),
    ),
    Ellipsoid: Kind(
        ("semi_axis_1", "semi_axis_2", "semi_axis_3"),
        "",
        9,
        Ellipsoid(_O, (1.0, 1.0, 1.0)),
        _three("semi_axes"),
        lambda turn, shift, sizes: Ellipsoid(_O, np.exp(sizes)).placed(
            Rotation.from_matrix(turn), shift
        ),
    ),
    Box: Kind(
        ("half_extent_1", "half_extent_2", "half_extent_3"),
        "",
        9,
        Box(_O, (1.0, 1.0, 1.0)),
        _three("half_extents"),
        lambda turn, shift, sizes: Box(_O, np.exp(sizes)).placed(Rotation.from_matrix(turn), shift),
        tuple(enumerate(np.eye(3))),
    ),
}


def kind_of(kind: type[Surface]) -> Kind:
    """What is known of a class of primitives; raises ValueError for any other."""
    if not isinstance(kind, type) or kind not in _KINDS:
        allowed = ", ".join(each.__name__ for each in _KINDS)
        name = getattr(kind, "__name__", repr(kind))
        raise ValueError(f"kind = {name}; allowed is one of the classes {allowed}")
    return _KINDS[kind]


@lanes()
def _jets(template: Any, sizes: Float[Array, "s"], point: Float[Array, "3"]) -> Any:
    """Distance and its gradient, of a solid with the given sizes."""
    solid = kind_of(type(template)).filled(template, sizes)
    return jax.value_and_grad(solid.distance)(point)


def told_of(kind: Kind, given: Gathered, fits: Shaped) -> Told:
    """What primitives say of contacts; derivatives by central differences."""
    own = Poses(fits.turn, fits.shift).own(given.point)
    step, share = 1e-4 * given.extent, 1e-4
    count = len(kind.names)
    points, sizes = [own], [fits.sizes]
    for axis in np.eye(3):
        points += [own + step * axis, own - step * axis]
        sizes += [fits.sizes] * 2
    for axis in np.eye(count):
        points += [own] * 2
        sizes += [fits.sizes + share * axis, fits.sizes - share * axis]
    # A plane has no sizes, but lanes need a number for each row.
    filled = np.exp(np.stack(sizes)) if count else np.ones((len(sizes), len(own), 1))
    wide = np.broadcast_to(filled[:, :, None], (*filled.shape[:2], own.shape[1], max(count, 1)))
    value, slope = _jets(
        kind.template, wide.reshape(-1, max(count, 1)), np.stack(points).reshape(-1, 3)
    )
    value = np.asarray(value).reshape(len(points), *own.shape[:2])
    slope = np.asarray(slope).reshape(len(points), *own.shape)
    bent = np.stack([slope[i] - slope[i + 1] for i in (1, 3, 5)], axis=-1) / (2 * step)
    jets = np.concatenate([value[..., None], slope], axis=-1)
    more = [(jets[7 + 2 * i] - jets[8 + 2 * i]) / (2 * share) for i in range(count)]
    whole = np.stack(more, axis=-1) if more else np.zeros((*own.shape[:2], 4, 0))
    return Told(value[0], slope[0], bent, whole)
