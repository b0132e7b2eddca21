"""How section, stiffness and mass vary along a rod."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb
from vibrissa.mechanics.models import check_thick

X = np.linspace(0, 1, 11)
CONE = vb.Rod.tapered(
    length=0.05, base_radius=1e-4, tip_radius=2e-5, youngs_modulus=3e9, density=1200.0
)


def test_stiffness_and_mass_of_a_truncated_cone() -> None:
    radius = 1e-4 - 8e-5 * X
    bending = CONE.bending_stiffness * CONE.bending_at(X)
    np.testing.assert_allclose(bending, 3e9 * np.pi / 4 * radius**4, rtol=1e-13)
    np.testing.assert_allclose(CONE.torsion_at(X), CONE.bending_at(X) / 1.3, rtol=1e-15)
    np.testing.assert_allclose(CONE.radius_at(X), radius, rtol=1e-14)
    np.testing.assert_allclose(CONE.linear_density_at(X), 1200 * np.pi * radius**2, rtol=1e-13)
    assert CONE.bending_at(np.zeros((2, 3))).shape == (2, 3)


def test_a_hollow_rod_has_no_stiffness_and_no_mass_in_its_bore() -> None:
    tube = vb.Rod.cylinder(
        length=0.1, radius=2e-4, inner_radius=1e-4, youngs_modulus=2e11, density=7850.0
    )
    assert tube.bending_stiffness == pytest.approx(2e11 * np.pi / 4 * 15e-16, rel=1e-13)
    assert tube.linear_density == pytest.approx(7850 * np.pi * 3e-8, rel=1e-13)
    drilled = vb.Rod.tapered(
        length=0.1, base_radius=2e-4, tip_radius=1.5e-4, inner_radius=1e-4, youngs_modulus=2e11
    )
    outer = 2e-4 - 0.5e-4 * X
    bending = drilled.bending_stiffness * drilled.bending_at(X)
    np.testing.assert_allclose(bending, 2e11 * np.pi / 4 * (outer**4 - 1e-16), rtol=1e-12)


def test_a_table_is_linear_in_the_radius_and_splitting_it_changes_nothing() -> None:
    coarse = {"arc_length": (0, 0.02, 0.05), "radius": (1e-3, 0.8e-3, 0.0)}
    fine = {
        "arc_length": (0, 0.005, 0.02, 0.03, 0.05),
        "radius": (1e-3, 0.95e-3, 0.8e-3, 0.8e-3 * 2 / 3, 0.0),
    }
    one, two = (vb.Rod.from_table(**table, youngs_modulus=1e9) for table in (coarse, fine))
    np.testing.assert_allclose(one.radius_at([0.2, 0.7]), [0.9e-3, 0.4e-3], rtol=1e-14)
    assert one == two
    assert hash(one) == hash(two)
    assert one.breaks == pytest.approx([0.4])
    assert vb.Rod.from_table(arc_length=(0, 0.1), radius=(1e-3, 1e-3), youngs_modulus=1e9).plain


def test_a_table_of_stiffness_is_linear_in_it() -> None:
    rod = vb.Rod.from_table(
        arc_length=(0, 0.03, 0.1),
        bending_stiffness=(2e-3, 1e-3, 0.5e-3),
        torsional_stiffness=(1e-3, 1e-3, 1e-3),
    )
    np.testing.assert_allclose(2e-3 * rod.bending_at([0, 0.3, 0.65]), [2e-3, 1e-3, 0.75e-3])
    np.testing.assert_allclose(2e-3 * rod.torsion_at(X), 1e-3)
    with pytest.raises(ValueError, match=r"^radius = None"):
        rod.radius_at(0.5)
    with pytest.raises(ValueError, match=r"^linear_density = None"):
        rod.linear_density_at(0.5)
    assert rod.own_sag() is None


def test_the_taper_can_be_differentiated() -> None:
    def bending(taper: float) -> jax.Array:
        return vb.Rod(1.0, 1.0, section=vb.Section.taper(taper)).bending_at(0.5)

    assert jax.grad(bending)(0.3) == pytest.approx(-4 * 0.5 * (1 - 0.15) ** 3, rel=1e-14)
    slope = jax.grad(lambda rod: rod.bending_stiffness * rod.radius_at(1.0))(CONE)
    assert slope.radius == pytest.approx(CONE.bending_stiffness * 0.2, rel=1e-14)


def test_a_section_by_hand_is_that_of_the_table() -> None:
    """Its columns may come from JAX, and its radius alone be differentiated beside a bore."""
    table = vb.Rod.from_table(
        arc_length=(0, 0.125, 0.5),
        radius=(0.5, 0.375, 0.0),
        inner_radius=(0.125, 0.125, 0.0),
        youngs_modulus=1e9,
    )
    by_hand = vb.Section(
        (0.0, 0.25, 1.0), radius=jnp.array([1, 0.75, 0]), bore=jnp.array([0.25, 0.25, 0])
    )
    assert by_hand == table.section

    def bending(tip: float) -> jax.Array:
        radius = jnp.array([1.0, tip])
        return vb.Section((0.0, 1.0), radius=radius, bore=np.full(2, 0.5)).bending_at(0.5)

    assert jax.grad(bending)(0.8) == pytest.approx(4 * 0.5 * 0.9**3 / (1 - 0.5**4), rel=1e-13)


def test_first_frequency_of_tapered_beams() -> None:
    """Complete cone: 8.71926 (H. H. Mabie, C. B. Rogers, J. Acoust. Soc. Am. 51 (1972) 1771); taper
    0 as for the uniform beam.
    """

    def root(taper: float) -> float:
        section = vb.Section.taper(taper)
        rod = vb.Rod(1.0, 1.0, linear_density=1.0, section=section, units="model")
        return 2 * np.pi * rod.first_natural_frequency()

    assert root(1.0) == pytest.approx(8.71926, rel=1e-6)
    uniform = vb.Rod(1.0, 1.0, linear_density=1.0, units="model")
    assert root(0.0) == pytest.approx(2 * np.pi * uniform.first_natural_frequency(), rel=1e-8)


def test_sag_of_a_cone_under_its_own_weight() -> None:
    """By w'' = M/EI with M = ρ A₀ g L² (1 − x)⁴/12 and EI = EI₀ (1 − x)⁴: a third."""
    cone = vb.Rod.tapered(
        length=0.05, base_radius=1e-4, tip_radius=0.0, youngs_modulus=3e9, density=1200.0
    )
    whole = vb.Rod.cylinder(length=0.05, radius=1e-4, youngs_modulus=3e9, density=1200.0)
    assert cone.own_sag() == pytest.approx(whole.own_sag() / 3, rel=1e-12)
    unweighed = vb.Rod.cylinder(length=0.05, radius=1e-4, youngs_modulus=25e6 * 1200.0)
    heavier = vb.Rod.cylinder(
        length=0.05, radius=1e-4, youngs_modulus=25e6 * 1200.0, density=1200.0
    )
    assert unweighed.own_sag() == pytest.approx(heavier.own_sag(), rel=1e-12)


TABLE = {"arc_length": (0, 0.1), "radius": (1e-3, 1e-4), "youngs_modulus": 1e9}
STIFF = {"arc_length": (0, 1), "bending_stiffness": (1, 1), "torsional_stiffness": (1, 1)}
TUBE = {"length": 0.1, "radius": 1e-3, "youngs_modulus": 1e9}
ENDS, NAN = (0.0, 1.0), float("nan")


def section(knots: tuple[float, ...] = ENDS, **columns: object) -> vb.Section:
    """By hand."""
    return vb.Section(knots, **{name: np.array(values) for name, values in columns.items()})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: vb.Section.taper(1.1), "taper = 1.1; allowed"),
        (lambda: vb.Section.taper(float("nan")), "taper = nan; allowed"),
        (
            lambda: vb.Rod.tapered(length=1, base_radius=1, tip_radius=-1, youngs_modulus=1),
            "tip_radius = -1; allowed",
        ),
        (lambda: vb.Rod.cylinder(**TUBE, inner_radius=1e-3), "inner_radius = 0.001; allowed"),
        (lambda: vb.Rod.cylinder(**TUBE, poisson_ratio=0.6), "poisson_ratio = 0.6; allowed"),
        (
            lambda: vb.Rod.from_table(**TABLE | {"arc_length": (0, 0.1, 0.1)}),
            r"arc_length\[2\] = 0.1; allowed is a number greater than 0.1",
        ),
        (lambda: vb.Rod.from_table(**TABLE | {"arc_length": (0.1, 0.2)}), "the first 0"),
        (
            lambda: vb.Rod.from_table(**TABLE | {"radius": [[1, 1]]}),
            r"radius has shape \(1, 2\); allowed is \(2,\)",
        ),
        (
            lambda: vb.Rod.from_table(**TABLE | {"radius": (0, 1)}),
            r"radius\[0\] = 0.0; allowed is a number greater than 0",
        ),
        (
            lambda: vb.Rod.from_table(**TABLE | {"radius": (1, np.nan)}),
            r"radius\[1\] = nan; allowed are finite",
        ),
        (lambda: vb.Rod.from_table(**TABLE, inner_radius=(1e-4, 1e-4)), r"inner_radius\[1\]"),
        (lambda: vb.Rod.from_table(arc_length=(0, 1), radius=(1, 1)), "youngs_modulus = None"),
        (
            lambda: vb.Rod.from_table(arc_length=(0, 1), bending_stiffness=(1, 1)),
            "torsional_stiffness = None",
        ),
        (
            lambda: vb.Rod.from_table(**TABLE, bending_stiffness=(1, 1)),
            "youngs_modulus = 1000000000.0; allowed is None where bending_stiffness is given",
        ),
        (
            lambda: vb.Rod.from_table(**STIFF, density=1200),
            "^density = 1200; allowed is None where bending_stiffness is given",
        ),
        (
            lambda: vb.Rod.from_table(**STIFF, inner_radius=1e-4),
            "inner_radius = 0.0001; allowed is 0 where bending_stiffness is given",
        ),
        (
            lambda: section(radius=(1, -0.5)),
            r"radius\[1\] = -0.5; allowed is a number of at least 0",
        ),
        (lambda: section(radius=(1, NAN)), r"radius\[1\] = nan; allowed are finite numbers"),
        (lambda: section(radius=(1, 1, 0.5)), r"radius has shape \(3,\); allowed is \(2,\)"),
        (
            lambda: section(radius=(2, 1)),
            r"radius\[0\] = 2.0; allowed is 1: the column is relative",
        ),
        (
            lambda: section(radius=(1, 0.5), bore=(0.6, 0.6)),
            r"bore\[1\] = 0.6; allowed is a number of at least 0 and below radius\[1\] = 0.5",
        ),
        (lambda: section(radius=(1, 0.5), bore=(-0.1, 0)), r"bore\[0\] = -0.1; allowed"),
        (lambda: section(radius=(1, 0.5), bore=(0.1, NAN)), r"bore\[1\] = nan; allowed are finite"),
        (lambda: section(radius=(1, 0.5), bore=0.1), r"bore has shape \(\); allowed is \(2,\)"),
        (
            lambda: section((0, 0.5, 1), bending=(1, 0, 1)),
            r"bending\[1\] = 0.0; allowed is a number greater than 0",
        ),
        (lambda: section(bending=(3, 1)), r"bending\[0\] = 3.0; allowed is 1"),
        (lambda: section(bending=(1, 1), torsion=(0, 1)), r"torsion\[0\] = 0.0; allowed"),
        (
            lambda: section(radius=(1, 1), linear_density=(1, -1)),
            r"linear_density\[1\] = -1.0; allowed",
        ),
        (lambda: section(torsion=(1, 1)), "radius = None, bending = None; allowed is a section"),
        (lambda: section(bending=(1, 1), bore=(0, 0)), r"radius = None, bore = array\(.*; allowed"),
        (lambda: section((0, 0.5), radius=(1, 1)), r"knots\[1\] = 0.5; allowed is 1: the tip"),
        (lambda: section((0.1, 1), radius=(1, 1)), r"knots = \[0.1, 1.0\]; .* the first 0"),
        (
            lambda: section((0, 0.7, 0.3, 1), radius=(1, 1, 1, 1)),
            r"knots\[2\] = 0.3; allowed is a number greater than 0.7",
        ),
        (lambda: section((0, NAN, 1), radius=(1, 1, 1)), r"knots\[1\] = nan; allowed are finite"),
    ],
)
def test_impossible_sections_are_named(make: object, message: str, no_shape_checks: None) -> None:
    with pytest.raises(ValueError, match=message):
        make()  # type: ignore[operator]


def test_a_tip_of_a_ten_thousandth_bears_contact_and_no_thinner_one() -> None:
    base, tip = 0.25e-3, 0.25e-7
    check_thick(vb.Rod.tapered(length=0.08, base_radius=base, tip_radius=tip, youngs_modulus=1e9))
    thinner = vb.Rod.tapered(
        length=0.08, base_radius=base, tip_radius=0.999 * tip, youngs_modulus=1e9
    )
    with pytest.raises(ValueError, match=r"allowed is at least 0\.0001"):
        check_thick(thinner)
