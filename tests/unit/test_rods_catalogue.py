"""Rods with published numbers."""

import numpy as np
import pytest

import vibrissa as vb


def test_spring_steel_has_the_moduli_of_its_standard() -> None:
    wire = vb.rods.spring_steel(length=0.05, radius=0.25e-3)
    inertia = np.pi / 4 * 0.25e-3**4
    assert wire.bending_stiffness == pytest.approx(206e9 * inertia, rel=1e-12)
    assert wire.bending_stiffness * wire.torsion_at(0.5) == pytest.approx(81.5e9 * 2 * inertia)
    assert wire.at(temperature=60).bending_stiffness < wire.bending_stiffness


def test_nitinol_is_softer_and_lighter_than_steel() -> None:
    steel, nitinol = (make(0.05, 0.2e-3) for make in (vb.rods.spring_steel, vb.rods.nitinol))
    assert 2 < steel.bending_stiffness / nitinol.bending_stiffness < 4
    assert nitinol.linear_density == pytest.approx(6450 * np.pi * 4e-8)


def test_a_whisker_is_as_those_measured() -> None:
    """C1 of dataset 7 of Belli et al. 2016: diameter 0.145 to 0.167 mm, 41 to 53 mm, 264 to 427 µg;
    its first frequency in air 30 to 60 Hz (M. A. Neimark et al., J. Neurosci. 23 (2003) 6499).
    """
    whisker = vb.rods.rat_whisker(row="C", column=1)
    assert whisker == vb.rods.rat_whisker(row=3, column=1)
    assert 0.145e-3 < 2 * whisker.radius < 0.167e-3
    assert whisker.length == pytest.approx(45.2e-3)
    x = (np.arange(1000) + 0.5) / 1000
    mass = whisker.length * np.mean(np.asarray(whisker.linear_density_at(x)))
    assert 264e-9 < mass < 427e-9
    assert 30 < whisker.first_natural_frequency() < 60
    # The parabola y = a x² with a = 8.85/m leaves the axis with the curvature 2a.
    assert whisker.rest.at(0.0)[1] == pytest.approx(2 * 8.85)


def test_whiskers_shorten_towards_the_snout() -> None:
    lengths = [vb.rods.rat_whisker(row="D", column=column).length for column in range(7)]
    assert np.all(np.diff(lengths) < 0)


@pytest.mark.parametrize(
    ("row", "column", "message"),
    [("F", 1, "row = 'F'"), (6, 1, "row = 6"), ("E", 0, "row E is 1 to 6"), ("A", 5, "column = 5")],
)
def test_whiskers_that_do_not_exist_are_named(row: object, column: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        vb.rods.rat_whisker(row=row, column=column)
