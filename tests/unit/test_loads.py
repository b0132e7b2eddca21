"""Weight, wind and other forces per length."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import vibrissa as vb

HERE, UP = np.zeros(3), np.array([0.0, 0.0, 1.0])
WIRE = vb.Rod.cylinder(length=0.05, radius=2e-4, youngs_modulus=2e11, density=7850.0)


def per_length(loads: vb.Loads, tangent: object = UP, radius: float = 2e-4) -> np.ndarray:
    return np.asarray(
        loads.per_length(0.01, HERE, jnp.asarray(tangent), radius=radius, linear_density=3e-3)
    )


def test_weight_is_mass_per_length_times_gravity() -> None:
    found = per_length(vb.Loads(gravity=(0.0, 1.0, -9.81)))
    np.testing.assert_allclose(found, [0, 3e-3, -9.81 * 3e-3], rtol=1e-15)


@pytest.mark.parametrize(
    ("reynolds", "coefficient"), [(1, 10.0), (10, 2.8), (100, 1.45), (1e3, 1.0), (1e4, 1.1)]
)
def test_drag_of_a_cylinder_is_as_tabulated(reynolds: float, coefficient: float) -> None:
    """Measured coefficients (C. Wieselsberger, 1921, as in H. Schlichting, Boundary-Layer Theory,
    fig. 1.4), read to 8 %.
    """
    loads = vb.Loads(wind=(reynolds * 1.825e-5 / (1.204 * 4e-4), 0.0, 0.0))
    pressure = 1.204 / 2 * loads.wind[0] ** 2 * 4e-4
    assert per_length(loads)[0] / pressure == pytest.approx(coefficient, rel=0.08)


def test_only_wind_across_the_rod_counts() -> None:
    tilted = np.array([0.6, 0.0, 0.8])
    found = per_length(vb.Loads(wind=(5.0, 0.0, 0.0)), tilted)
    assert abs(found @ tilted) < 1e-15
    # Of the wind, 0.8 · 5 m/s goes across, along (0.8, 0, −0.6).
    np.testing.assert_allclose(
        found, per_length(vb.Loads(wind=(4.0, 0.0, 0.0)))[0] * np.array([0.8, 0, -0.6]), rtol=1e-12
    )
    np.testing.assert_allclose(per_length(vb.Loads(wind=5 * tilted), tilted), 0.0, atol=1e-12)


def test_drag_has_a_derivative_where_the_air_rests() -> None:
    def drag(wind: jax.Array) -> jax.Array:
        return vb.Loads().drag(wind, UP, 2e-4)

    value, slope = jax.jvp(drag, (jnp.zeros(3),), (jnp.array([1.0, 0.0, 0.0]),))
    np.testing.assert_array_equal(value, 0.0)
    assert slope[0] > 0
    assert np.isfinite(np.asarray(jax.hessian(lambda v: drag(v)[0])(jnp.zeros(3)))).all()


def test_wind_may_depend_on_the_place_and_any_force_can_act() -> None:
    jet = vb.Loads(wind=lambda p: jnp.array([1.0, 0.0, 0.0]) + p)
    np.testing.assert_allclose(per_length(jet), per_length(vb.Loads(wind=(1.0, 0, 0))), rtol=1e-14)
    both = vb.Loads(gravity=(0, 0, -9.81), force=lambda s, p, t: 2 * s * t + p)
    np.testing.assert_allclose(per_length(both), [0, 0, 0.02 - 9.81 * 3e-3], rtol=1e-14)


def test_a_loaded_rod_is_a_pytree_that_hashes() -> None:
    rod = WIRE.loaded(vb.Loads(gravity=(0, 0, -9.81), wind=lambda p: p))
    assert not rod.plain
    assert hash(rod) == hash(jax.tree.map(lambda leaf: leaf, rod))
    slope = jax.grad(lambda rod: jnp.sum(jnp.asarray(rod.loads.gravity) ** 2))(rod)
    assert slope.loads.gravity[2] == pytest.approx(2 * -9.81)
    assert WIRE.loaded(vb.Loads()) == WIRE


def test_loads_need_what_they_act_on() -> None:
    bare = vb.Rod(0.05, 1e-3)
    with pytest.raises(ValueError, match=r"linear_density = None: gravity needs"):
        bare.loaded(vb.Loads(gravity=(0, 0, -9.81)))
    with pytest.raises(ValueError, match=r"radius = None"):
        bare.loaded(vb.Loads(wind=(1, 0, 0)))
    with pytest.raises(ValueError, match=r"units = 'model': wind"):
        vb.Rod.unit().loaded(vb.Loads(wind=(1, 0, 0)))


FUNCTIONS = {
    "force": lambda s, p, t: jnp.sqrt(s - 0.02) * p,
    "wind": lambda p: jnp.log(p[2] - 0.01) * jnp.ones(3),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_that_returns_no_numbers_is_named(name: str) -> None:
    rod = WIRE.loaded(vb.Loads(**{name: FUNCTIONS[name]}))
    trail = vb.Trail.line(start=(0.03, 0.002, 0), stop=(0, 0.002, 0), count=3)
    zero = np.zeros((3, 3))
    message = rf"^{name}: .* returns \[nan.* at the position \[0.03, 0.002, 0.0\] on the rod"
    with pytest.raises(ValueError, match=message):
        vb.scan(rod, vb.surfaces.Sphere(center=(0, 0, 0.06), radius=0.02), trail)
    with pytest.raises(ValueError, match=message):
        vb.reconstruct(rod, vb.Reactions(trail, zero, zero))


def test_a_wind_that_blows_the_rod_over_is_named() -> None:
    thin = vb.Rod.cylinder(length=0.05, radius=5e-5, youngs_modulus=3e9)
    trail = vb.Trail.line(start=(0.03, 0.002, 0), stop=(0, 0.002, 0), count=3)
    ball = vb.surfaces.Sphere(center=(0, 0, 0.06), radius=0.02)
    scan = vb.scan(thin.loaded(vb.Loads(wind=(50, 0, 0))), ball, trail)
    assert np.all(scan.status == vb.Status.FALLS_OVER)
    assert "wind" in vb.Status.FALLS_OVER.text


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"gravity": (0, 0)}, "gravity has shape"),
        ({"wind": (0, 0, float("nan"))}, r"wind\[2\] = nan"),
        ({"viscosity": 0.0}, "viscosity = 0.0"),
        ({"wind": lambda p: p[0]}, "wind: .* returns"),
        ({"force": lambda s, p, t: float(s) * t}, "force: .* cannot be traced"),
    ],
)
def test_impossible_loads_are_named(given: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        vb.Loads(**given)
