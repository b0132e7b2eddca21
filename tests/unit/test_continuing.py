"""How sure a contact is that continues, on drawn places: one of each row is the true one, the other
goes its own way.
"""

import numpy as np
import pytest

from vibrissa.inverse.smoothing.branches import Places, marginals

COUNT, SURE = 80, 0.95
FORCE = np.linspace(0.1, 1.0, COUNT)


def way(rng: np.random.Generator) -> np.ndarray:
    """Of a contact that slides along the flank, or of a wrong one."""
    return rng.uniform(0, 1) + rng.uniform(-8e-4, 8e-4) * np.arange(COUNT)


def listed(rng: np.random.Generator, true: np.ndarray, noise: float) -> list[np.ndarray]:
    """Probabilities of the true place and the wrong one, row by row; the same readings give both,
    so their errors are correlated.
    """
    ways, correlation = np.stack([true, way(rng)], axis=1), rng.uniform(-0.9, 0.9)
    deviation = noise / FORCE[:, None] * [1, rng.uniform(0.3, 3)]
    together = np.linalg.cholesky([[1, correlation], [correlation, 1]])
    errors = deviation * (rng.normal(size=(COUNT, 2)) @ together.T)
    places = [Places(*row) for row in zip(ways + errors, deviation, strict=True)]
    return marginals(places, np.full(COUNT - 1, 1e-3))


@pytest.mark.parametrize("noise", [3e-4, 1e-3, 5e-3])
def test_sure_rows_are_right(noise: float) -> None:
    """Half of the touches at the tip: those are told, the others stay open."""
    rng = np.random.default_rng(1)
    at_tip, flank = (
        np.array([listed(rng, true(), noise) for _ in range(100)])
        for true in (lambda: np.ones(COUNT), lambda: way(rng))
    )
    sure, wrong = (
        np.sum([np.sum(part[..., i] >= SURE) for part in (at_tip, flank)]) for i in (0, 1)
    )
    assert wrong < 0.05 * (sure + wrong)
    assert np.mean(at_tip[..., 0] >= SURE) > 0.9
    assert np.mean(flank.max(axis=-1) >= SURE) < 0.2


def test_a_noisy_place_is_as_probable_as_one_that_creeps_with_less_noise() -> None:
    rng = np.random.default_rng(2)
    deviation = np.array([3e-3, 3e-4])
    steady = np.stack([np.full(COUNT, 0.7), 0.3 + 4e-4 * np.arange(COUNT)], axis=1)
    places = [Places(row, deviation) for row in steady + deviation * rng.normal(size=(COUNT, 2))]
    np.testing.assert_allclose(marginals(places, np.full(COUNT - 1, 1e-3)), 0.5, atol=0.02)


def test_rows_with_one_contact_tell_of_those_before_and_after() -> None:
    both, first = (Places(np.array(at), np.full(len(at), 2e-3)) for at in ([0.4, 0.8], [0.4]))
    weights = marginals([both] * 20 + [first] * 5 + [both] * 20, np.full(44, 1e-3))
    assert min(weight[0] for weight in weights) > SURE
