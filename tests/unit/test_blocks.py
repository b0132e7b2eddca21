"""Rows come out of the blocks as they went in, however many there are."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from vibrissa.numerics.blocks import from_blocks, in_blocks, to_blocks


@jax.jit
def moment(position: jax.Array, force: jax.Array) -> jax.Array:
    """R × F for blocks (blocks, 3, width), which mixes no lanes."""
    return jnp.cross(position, force, axis=1)


@pytest.mark.parametrize("count", [1, 2, 8, 9, 64, 65, 300, 5000, 140_001])
def test_every_row_gets_its_own_result(count: int) -> None:
    position, force = np.random.default_rng(count).normal(size=(2, count, 3))
    np.testing.assert_allclose(
        in_blocks(moment, position, force), np.cross(position, force), rtol=0, atol=1e-14
    )


@pytest.mark.parametrize(("count", "lanes", "blocks"), [(5, 8, 1), (64, 64, 1), (100, 8, 16)])
def test_back_from_blocks(count: int, lanes: int, blocks: int) -> None:
    rows = np.arange(count * 6.0).reshape(count, 2, 3)
    split = to_blocks(rows, lanes, blocks)
    assert split.shape == (blocks, 2, 3, lanes)
    np.testing.assert_array_equal(split[0, :, :, 1], rows[1])
    np.testing.assert_array_equal(from_blocks(split, count), rows)
