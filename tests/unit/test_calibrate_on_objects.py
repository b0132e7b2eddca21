"""Calibration on other objects than a ball."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from calibration_bench import (
    FORCE_TARE,
    NAMES,
    TORQUE_TARE,
    independent,
    sensor,
    setup,
    true_values,
    wrong,
)
from calibration_sweeps import CENTER, EGG, PLANE
from scipy.stats import chi2

import vibrissa as vb
from vibrissa.surfaces import Mesh, Plane, Surface


def _egg() -> Surface:
    # Faces so fine that contacts on them are off by a tenth of the robot's noise.
    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.apply_scale(EGG)
    mesh.apply_translation(CENTER)
    return Mesh(mesh.vertices, mesh.faces)


OBJECTS = {"plane": lambda: Plane(*PLANE), "egg": _egg}


@pytest.mark.parametrize("name", OBJECTS)
def test_rod_and_clamp_are_found_on_it(name: str) -> None:
    """Errors from a start that is far off are those of the stated covariance."""
    noisy, rng = sensor(), np.random.default_rng(0)
    recordings = [
        noisy.measure(
            independent(f"{name} {y}"), rng, force_tare=FORCE_TARE, torque_tare=TORQUE_TARE
        )
        for y in ("+0.005", "-0.010")
    ]
    start = wrong(replace(setup(noisy), surface=OBJECTS[name]()))
    found, truth = vb.calibrate(recordings, start), true_values(start)
    assert found.identifiability.names == NAMES
    error = np.array([found.estimates[name].value - truth[name] for name in NAMES])
    assert error @ np.linalg.solve(found.covariance, error) < chi2.isf(1e-3, len(NAMES))
    assert found.estimates["youngs_modulus"].deviation < 0.01 * 206e9
    assert found.fitness.reduced_chi_square == pytest.approx(1, abs=0.15)
    assert found.unevenness == 0


def test_tips_on_a_plane_do_not_tell_length_from_clamp_under_noise() -> None:
    """With twenty times the noise a ruler knows the length better."""
    noisy, rng = sensor(noise=20.0), np.random.default_rng(0)
    swept = [noisy.measure(independent(f"plane {y}"), rng) for y in ("+0.005", "-0.010")]
    with pytest.warns(vb.RecordingWarning, match="with its tip only"):
        found = vb.calibrate(swept, replace(setup(noisy), surface=Plane(*PLANE)))
    length = found.estimates["length"]
    assert not length.determined or length.deviation > 0.01 * length.value
