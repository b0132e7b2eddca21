"""Rows come out of the lanes as they went in, however many there are, on any number of threads."""

import threading
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrissa.numerics.lanes import in_threads, lanes, threads


class Arm(NamedTuple):
    """A force at a place."""

    position: jax.Array
    force: jax.Array


class Turned(NamedTuple):
    """Its moment, and how large that is."""

    moment: jax.Array
    size: jax.Array


class Factor(NamedTuple):
    """What all rows share, whose code is large enough for a call of each row."""

    value: jax.Array

    @property
    def bulky(self) -> bool:
        """As in `vibrissa.numerics.lanes`."""
        return True


class Told(NamedTuple):
    """Results of several kinds."""

    turned: Turned
    long: jax.Array
    which: jax.Array


def _moment(factor: jax.Array, arm: Arm) -> Turned:
    """R × F, times what all rows share."""
    found = factor * jnp.cross(arm.position, arm.force)
    return Turned(found, jnp.sqrt(jnp.sum(found**2)))


moment = lanes(width=8, blocks=4, alone=True)(_moment)


@lanes(by_call=True)
def told(factor: Factor, arm: Arm) -> Told:
    """The same, whether it is long, and its largest component."""
    found = _moment(factor.value, arm)
    which = jnp.argmax(jnp.abs(found.moment)).astype(jnp.int8)
    return Told(found, found.size > 1, which)


@pytest.mark.parametrize("count", [0, 1, 2, 8, 9, 32, 33, 300, 5001])
@pytest.mark.parametrize("cores", ["1", "2"])
def test_every_row_gets_its_own_result(
    count: int, cores: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VIBRISSA_THREADS", cores)
    position, force = np.random.default_rng(count).normal(size=(2, count, 3))
    found = moment(np.array(2.0), Arm(position, force))
    expected = 2 * np.cross(position, force)
    np.testing.assert_allclose(found.moment, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.size, np.linalg.norm(expected, axis=1), rtol=0, atol=1e-13)


@pytest.mark.parametrize("count", [0, 1, 2, 511, 512, 1100])
def test_rows_that_are_called_are_like_others(count: int) -> None:
    position, force = np.random.default_rng(count).normal(size=(2, count, 3))
    found = told(Factor(np.array(2.0)), Arm(position, force))
    expected = 2 * np.cross(position, force)
    size = np.linalg.norm(expected, axis=1)
    np.testing.assert_allclose(found.turned.moment, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(found.turned.size, size, rtol=0, atol=1e-13)
    np.testing.assert_array_equal(found.long, size > 1)
    np.testing.assert_array_equal(found.which, np.argmax(np.abs(expected), axis=1))
    assert (found.long.dtype, found.which.dtype) == (bool, np.int8)


def test_within_a_thread_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIBRISSA_THREADS", "3")
    assert threads() == 3
    assert in_threads(lambda part: (part, threads()), range(4)) == [(part, 1) for part in range(4)]


def test_what_fails_in_a_thread_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIBRISSA_THREADS", "2")
    with pytest.raises(ZeroDivisionError):
        in_threads(lambda part: 1 / part, [1, 0])


def test_what_is_compiled_ahead_is_traced_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VIBRISSA_THREADS", "2")
    traced, before = [], set(threading.enumerate())

    @lanes(width=8, blocks=4)
    def twice(_: None, x: jax.Array) -> jax.Array:
        traced.append(threading.current_thread())
        return 2 * x

    for _ in range(2):
        twice.ahead(None, np.zeros(1))
    for thread in set(threading.enumerate()) - before:
        thread.join()
    np.testing.assert_array_equal(twice(None, np.arange(40.0)), 2 * np.arange(40.0))
    assert len(traced) == 1
    assert traced[0] is not threading.current_thread()


def test_what_fails_ahead_is_raised_where_it_is_wanted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("VIBRISSA_THREADS", "2")

    @lanes()
    def bad(_: None, x: jax.Array) -> jax.Array:
        raise ZeroDivisionError

    bad.ahead(None, np.zeros(1))
    with pytest.raises(ZeroDivisionError):
        bad(None, np.zeros(1))
    assert not capsys.readouterr().err
