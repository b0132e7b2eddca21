"""Which of several known objects was touched."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_locate import ELLIPSOID, around, touched

import vibrissa as vb

SURFACES = vb.surfaces
OBJECTS = {
    "ball": SURFACES.Sphere((0, 0, 0), 0.02),
    "ellipsoid": ELLIPSOID,
    "box": SURFACES.Box((0, 0, 0), (0.02, 0.015, 0.01)),
    "torus": SURFACES.Torus((0, 0, 0), (0, 0, 1), 0.02, 0.006),
}


@pytest.mark.parametrize("name", ["ball", "torus"])
def test_each_object_is_told_by_twelve_contacts(name: str) -> None:
    rng = np.random.default_rng(len(name))
    contacts, _, _ = touched(OBJECTS[name], around(rng, 12), rng)
    found = vb.identify(OBJECTS, contacts)
    assert found.name == name
    assert found.probability > 0.99
    assert not found.warnings
    np.testing.assert_allclose(found.location.placed.distances(contacts.point), 0, atol=2e-4)


@pytest.mark.slow
def test_probabilities_are_as_often_right_as_they_say() -> None:
    # The third axis of one differs by three deviations of what three contacts tell.
    like = {
        "one": ELLIPSOID,
        "other": SURFACES.Ellipsoid((0, 0, 0), (0.026, 0.021, 0.0173)),
    }
    rng, chances = np.random.default_rng(0), []
    for number in range(24):
        true = "one" if number % 2 else "other"
        contacts, _, _ = touched(like[true], around(rng, 6), rng)
        found = vb.identify(like, contacts)
        chances.append({each.name: each.probability for each in found.candidates}[true])
        assert sum(each.probability for each in found.candidates) == pytest.approx(1)
        doubted = min(each.probability for each in found.candidates) > 0.05
        assert any("hardly tell" in line for line in found.warnings) == doubted
    # Of a calibrated probability p, the true one has p² + (1 − p)² on average.
    expected = np.mean([p**2 + (1 - p) ** 2 for p in chances])
    assert np.mean(chances) == pytest.approx(expected, abs=0.1)
    assert np.mean(chances) > 0.6


def test_an_object_that_is_none_of_them() -> None:
    rng = np.random.default_rng(3)
    other = SURFACES.Capsule((0, 0, 0), (0, 0, 1), 0.012, 0.03)
    contacts, _, _ = touched(other, around(rng, 12), rng)
    found = vb.identify(OBJECTS, contacts)
    assert any("none of the objects fits" in line for line in found.warnings)


def test_one_bad_object_does_not_stop_the_others() -> None:
    rng = np.random.default_rng(4)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 12), rng)
    far = SURFACES.Sphere((1e6, 0, 0), 0.02)
    found = vb.identify({"far": far, "ellipsoid": ELLIPSOID}, contacts)
    assert found.name == "ellipsoid"
    assert "near its origin" in found.failed["far"]
    assert any("far was left out" in line for line in found.warnings)
    with pytest.raises(ValueError, match="none can be located"):
        vb.identify([far], contacts)
    with pytest.raises(ValueError, match="at least one"):
        vb.identify({}, contacts)


def test_a_turned_object_is_the_same() -> None:
    rng = np.random.default_rng(5)
    contacts, _, _ = touched(ELLIPSOID, around(rng, 8), rng)
    turned = ELLIPSOID.placed(Rotation.from_rotvec([0.3, 0.2, -0.5]), (0.001, 0, 0))
    found = vb.identify([ELLIPSOID, turned], contacts)
    assert found.probability == pytest.approx(0.5, abs=0.05)
    assert any("hardly tell" in line for line in found.warnings)
