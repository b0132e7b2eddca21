"""What figures are made of, checked before anything is drawn."""

from collections.abc import Callable
from functools import wraps
from inspect import signature
from types import UnionType
from typing import ParamSpec, TypeVar, get_args, get_origin, get_type_hints

P = ParamSpec("P")
R = TypeVar("R")


def checked(figure: Callable[P, R]) -> Callable[P, R]:
    """Raise TypeError unless the first argument of a figure is what its annotation says."""
    name = next(iter(signature(figure).parameters))
    annotation = get_type_hints(figure)[name]
    kinds = get_args(annotation) if isinstance(annotation, UnionType) else (annotation,)
    allowed = tuple(get_origin(kind) or kind for kind in kinds)

    @wraps(figure)
    def drawn(*args: P.args, **kwargs: P.kwargs) -> R:
        value = args[0] if args else kwargs.get(name)
        if not isinstance(value, allowed):
            names = ", ".join(kind.__name__ for kind in allowed)
            raise TypeError(f"{name} is a {type(value).__name__}; allowed is {names}")
        return figure(*args, **kwargs)

    return drawn
