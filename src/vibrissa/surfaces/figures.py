"""Solids given by a few numbers, which are checked and converted when the solid is built."""

from functools import partial
from typing import Annotated, Any, TypeAlias, get_args, get_origin, get_type_hints

from vibrissa.geometry.checks import finite, finite_array, positive, positive_array, unit_vector
from vibrissa.surfaces.base import Surface

Number: TypeAlias = Annotated[float, finite]
Positive: TypeAlias = Annotated[float, positive]
Vector3: TypeAlias = Annotated[Any, partial(finite_array, last=3, ndim=1)]
"""Three numbers, as a list, tuple or array; kept as an array (3,)."""
Direction: TypeAlias = Annotated[Any, unit_vector]
"""Three numbers that are not all zero; kept as an array (3,) of length 1."""
Positive3: TypeAlias = Annotated[Any, partial(positive_array, last=3)]
"""Three numbers above zero."""
Positive2: TypeAlias = Annotated[Any, partial(positive_array, last=2)]
"""Two numbers above zero."""


class Figured(Surface):
    """A solid that is convex, or rounded on the scale of its own dimensions; its fields have the
    types above, each of which carries its own check.
    """

    may_crease = False

    def __post_init__(self) -> None:
        for name, kind in get_type_hints(type(self), include_extras=True).items():
            if get_origin(kind) is Annotated:
                setattr(self, name, get_args(kind)[1](getattr(self, name), name))
