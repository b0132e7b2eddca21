"""Compilation of the heavy kernels."""

from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache, wraps
from typing import ParamSpec, TypeVar

import jax
from jax import Array
from jax.extend.core import ClosedJaxpr, Jaxpr

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


@lru_cache(maxsize=1)
def _options() -> dict[str, bool]:
    """XLA's older loop emitter keeps Newton's method in one vectorised loop: measured twice as fast
    here, and quicker to compile.
    """
    options = {"xla_cpu_use_fusion_emitters": False}
    try:
        jax.jit(lambda x: x + 1, compiler_options=options)(0.0)
    except Exception:  # a release of XLA without the option, whatever it raises
        return {}
    return options


def compiled(function: Callable[Parameters, Result]) -> Callable[Parameters, Result]:
    """`jax.jit` with the options above, set up at the first call so that importing a module does
    not start a backend.
    """

    @lru_cache(maxsize=1)
    def build() -> Callable[Parameters, Result]:
        return jax.jit(function, compiler_options=_options())

    @wraps(function)
    def call(*arguments: Parameters.args, **named: Parameters.kwargs) -> Result:
        return build()(*arguments, **named)

    return call


def operation_count(function: Callable[[Array], Array], argument: Array) -> int:
    """How many operations a function traces to, those of its loops' bodies counted once."""
    return _operations(jax.make_jaxpr(function)(argument).jaxpr)


def _operations(jaxpr: Jaxpr) -> int:
    return sum(
        1 + sum(map(_operations, _inner(equation.params.values()))) for equation in jaxpr.eqns
    )


def _inner(parameters: Iterable[object]) -> Iterator[Jaxpr]:
    """Programs within an operation: bodies of loops, branches, functions called."""
    for parameter in parameters:
        if isinstance(parameter, Jaxpr):
            yield parameter
        elif isinstance(parameter, ClosedJaxpr):
            yield parameter.jaxpr
        elif isinstance(parameter, (tuple, list)):
            yield from _inner(parameter)
