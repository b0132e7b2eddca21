"""The spatial solver, with as many steps as it takes by default, gives on the paper's rod what the
closed form gives, field by field: scans and reconstructions, with and without friction.
"""

from dataclasses import fields, replace
from importlib import import_module

import numpy as np
import pytest

import vibrissa as vb
from vibrissa.mechanics.models import spatial

CLOSE = 1e-10
BOWL = vb.surfaces.EllipticParaboloid(a=0.5, b=1.0, h=0.4)
TRAILS = vb.Trail.raster(
    start=(1.2, 0.1, 0), stop=(-1.2, 0.1, 0), count=41, step=(0, 0.2, 0), trails=3
)
UNMEASURED = 1e-9
"""Noise [EI/L] of the moment about the clamp's axis. It does no work on a straight rod: the closed
form lets it move the contact off the rod, the spatial one twists the rod, so that errors of the point
differ by what is in that channel.
"""
NOISE = np.diag([1e-3] * 5 + [UNMEASURED]) ** 2
Both = tuple[vb.Scan, vb.Scan]


def by_spatial_rods(patch: pytest.MonkeyPatch) -> None:
    for module in ("vibrissa.forward.scan", "vibrissa.inverse.shared"):
        patch.setattr(import_module(module), "model_of", spatial)


def scanned(friction: float) -> Both:
    found = vb.scan(vb.Rod.unit(), BOWL, TRAILS, friction=friction)
    with pytest.MonkeyPatch.context() as patch:
        by_spatial_rods(patch)
        return found, vb.scan(vb.Rod.unit(), BOWL, TRAILS, friction=friction)


@pytest.fixture(scope="module")
def smooth() -> Both:
    return scanned(0.0)


@pytest.fixture(scope="module")
def rough() -> Both:
    return scanned(0.3)


def off(found: object, expected: object) -> dict[str, float]:
    """Largest difference in each field of two results, relative to the field's largest number if
    that exceeds 1; integers and NaN must be the same.
    """
    largest = {}
    for name, ours, theirs in arrays(found, expected):
        if ours.dtype.kind in "ib":
            np.testing.assert_array_equal(ours, theirs, err_msg=name)
            continue
        known = np.isfinite(theirs)
        np.testing.assert_array_equal(np.isfinite(ours), known, err_msg=name)
        scale = np.max(abs(theirs[known]), initial=1.0)
        largest[name] = float(np.max(abs(ours - theirs)[known], initial=0.0) / scale)
    return largest


def arrays(found: object, expected: object) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Fields that hold one entry per row, by name."""
    both = []
    for name in (field.name for field in fields(found)):  # type: ignore[arg-type]
        ours, theirs = getattr(found, name), getattr(expected, name)
        if isinstance(ours, vb.Reactions):
            both += [(part, getattr(ours, part), getattr(theirs, part)) for part in PARTS]
        elif isinstance(ours, np.ndarray):
            both.append((name, ours, theirs))
    return both


PARTS = ("force", "moment")


def assert_close(errors: dict[str, float]) -> None:
    assert {name: size for name, size in errors.items() if size > CLOSE} == {}


@pytest.mark.parametrize("friction", ["smooth", "rough"])
def test_scans_agree_in_every_field_and_event(
    friction: str, request: pytest.FixtureRequest
) -> None:
    """With friction too, whose history begins where the contact does."""
    both: Both = request.getfixturevalue(friction)
    errors = off(*both)
    assert len(errors) == 15
    assert_close(errors)
    assert np.count_nonzero(both[0].in_contact) > 80
    first, second = (scan.events for scan in both)
    assert [at.kind for at in first] == [at.kind for at in second]
    for ours, theirs in zip(first, second, strict=True):
        np.testing.assert_allclose(ours.parameter, theirs.parameter, atol=CLOSE)
        np.testing.assert_allclose(ours.point, theirs.point, atol=CLOSE)
        np.testing.assert_allclose(ours.clamp, theirs.clamp, atol=CLOSE)


def test_fewer_steps_leave_no_more_than_the_accuracy_asked_for(smooth: Both) -> None:
    """At 1e-8, in every field; and they are fewer, as they leave more than by default."""
    with pytest.MonkeyPatch.context() as patch:
        by_spatial_rods(patch)
        found = vb.scan(vb.Rod.unit(), BOWL, TRAILS, accuracy=1e-8)
    errors = off(found, smooth[0])
    assert {name: size for name, size in errors.items() if size > 1e-8} == {}
    assert max(errors.values()) > CLOSE


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize(
    "noise", [None, pytest.param(NOISE, marks=pytest.mark.slow)], ids=["exact", "noisy"]
)
def test_reconstructions_agree_in_every_field(
    smooth: Both, rough: Both, friction: float, noise: np.ndarray | None
) -> None:
    reactions = replace((rough if friction else smooth)[0].reactions, covariance=noise)
    found = vb.reconstruct(vb.Rod.unit(), reactions, friction=friction)
    with pytest.MonkeyPatch.context() as patch:
        by_spatial_rods(patch)
        again = vb.reconstruct(vb.Rod.unit(), reactions, friction=friction)
    errors = off(again, found)
    assert len(errors) == (8 if noise is None else 14)
    assert_close(errors)
