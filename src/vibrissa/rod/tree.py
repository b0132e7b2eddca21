"""Descriptions of a rod as values: pytrees that compare and hash by what they hold."""

from collections.abc import Callable
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

if TYPE_CHECKING:
    Figure: TypeAlias = float
else:
    # A JAX tracer when differentiating with respect to the rod.
    Figure = float | jax.Array

T = TypeVar("T")


class Described:
    """Compares and hashes by value, arrays included; shows what differs from the defaults."""

    def _key(self) -> tuple[Any, ...]:
        return tuple(_hashable(getattr(self, field.name)) for field in fields(self))  # type: ignore[arg-type]

    def __eq__(self, other: object) -> bool:
        """Whether all values are equal."""
        return type(other) is type(self) and self._key() == other._key()

    def __hash__(self) -> int:
        """By value."""
        return hash((type(self), self._key()))

    def __repr__(self) -> str:
        """The class, with what is not left at its default; arrays by their shape."""
        shown = [
            f"{field.name}={_shown(value)}"
            for field in fields(self)  # type: ignore[arg-type]
            if isinstance(value := getattr(self, field.name), jax.Array | np.ndarray)
            or value != field.default
        ]
        return f"{type(self).__name__}({', '.join(shown)})"


def tree(*static: str) -> Callable[[type[T]], type[T]]:
    """Register a frozen dataclass as a pytree. The fields in `static`, and functions, are part of
    its structure. What JAX puts into a tree is not checked: it need not be a number.
    """

    def register(cls: type[T]) -> type[T]:
        names = [field.name for field in fields(cls)]  # type: ignore[arg-type]

        def flatten(value: T) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
            held = [getattr(value, name) for name in names]
            fixed = [name in static or callable(part) for name, part in zip(names, held)]  # noqa: B905
            return (
                tuple(part for part, still in zip(held, fixed, strict=True) if not still),
                tuple(
                    (name, still, part if still else None)
                    for name, part, still in zip(names, held, fixed, strict=True)
                ),
            )

        def unflatten(structure: tuple[Any, ...], children: tuple[Any, ...]) -> T:
            value, parts = object.__new__(cls), iter(children)
            for name, still, part in structure:
                object.__setattr__(value, name, part if still else next(parts))
            return value

        jax.tree_util.register_pytree_node(cls, flatten, unflatten)
        return cls

    return register


def known(*values: Any) -> bool:
    """Whether all leaves are numbers, none a JAX tracer."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(values))


def array(values: Any) -> Any:
    """NumPy's array of numbers, JAX's where there is a tracer."""
    return np.asarray(values, dtype=float) + 0.0 if known(values) else jnp.asarray(values)


def _hashable(value: Any) -> Any:
    if isinstance(value, np.ndarray | jax.Array) and np.ndim(value):
        array = np.asarray(value)
        return array.shape, array.tobytes()
    return float(value) if isinstance(value, jax.Array) else value


def _shown(value: Any) -> str:
    if isinstance(value, np.ndarray | jax.Array) and np.ndim(value):
        return f"<{' × '.join(map(str, value.shape))}>"
    return repr(value)
