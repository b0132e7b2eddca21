"""Whether deviations can be believed, as surfaces through either half of the sweeps tell."""

from typing import Any

import numpy as np
import pytest
from test_fit_shape import ELLIPSOID, samples
from touched import rings

import vibrissa as vb
from vibrissa.shape import fit, halves
from vibrissa.shape.noise import columns_of

SWEEPS = 30


@pytest.fixture(scope="module")
def inner() -> tuple[vb.Shape, list[Any]]:
    """A surface, and what its halves were judged by."""
    given = rings(ELLIPSOID, np.random.default_rng(7), sweeps=SWEEPS)
    seen: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        for name in ("told_by_half", "agreement"):
            judge = getattr(halves, name)
            patch.setattr(fit, name, lambda *a, judge=judge: seen.append(a) or judge(*a))
        return vb.fit_shape(given), seen


@pytest.mark.parametrize("size", [0.5, 1.0, 1.5])
def test_surfaces_as_random_as_said_differ_by_as_much_as_said(inner, size, monkeypatch):
    """Surfaces and errors drawn with the deviations that are stated, with half of them, and more."""
    monkeypatch.setattr(halves, "_BEFORE", 0)
    (data, noise, sites), (known, _, _, sweeps) = inner[1]
    rng, found = np.random.default_rng(0), []
    for _ in range(6):
        target = rng.normal(size=len(data.rows)) @ data.rows
        for rows in noise.groups:
            root = np.linalg.cholesky(noise.among(rows, data.open[rows]))
            target[columns_of(rows)] += root @ rng.normal(size=len(root))
        drawn = data._replace(target=size * target.reshape(-1, 4))
        told = halves.told_by_half(drawn, noise, sites)
        all_ = told[0].and_that(told[1]).posterior(known.basis)
        found.append(halves.agreement(all_, drawn, told, sweeps))
    assert np.mean(found) == pytest.approx(size, rel=0.08, abs=0.08)


def test_an_ellipsoid_is_smoother_than_random_surfaces(inner):
    shape = inner[0]
    assert 0.5 < shape.level.agreement < 0.95
    points = samples(ELLIPSOID)
    held = np.abs(shape.distance(points)) < 1.96 * shape.deviation(points)
    assert 0.9 < held.mean() < 0.99


def test_few_sweeps_tell_nothing_of_that(inner):
    assert halves.agreement(*inner[1][1][:3], halves._LEAST - 1) == 1.0
    assert halves.agreement(*inner[1][1][:3], halves._LEAST) < 1.0
