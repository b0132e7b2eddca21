"""The surface of the 60 mm ball from four recorded sweeps of an independent engine."""

from pathlib import Path

import numpy as np

import vibrissa as vb

CENTER, RADIUS = np.array([0.0, 0.0, 0.0575]), 0.03


def test_four_sweeps_make_a_ball(sphere_60mm: Path) -> None:
    setup = vb.load_setup(sphere_60mm / "setup.toml")
    contacts = [
        vb.smooth(vb.reconstruct(setup.rod, vb.read_recording(path, setup))).contacts
        for path in sorted((sphere_60mm / "frictionless").glob("trail_y?0.?0.csv"))
    ]
    assert len(contacts) == 4
    shape = vb.fit_shape(contacts)
    mesh = shape.mesh()
    away = np.abs(np.linalg.norm(mesh.vertices - CENTER, axis=1) - RADIUS)
    assert away.mean() < 0.03e-3
    assert np.mean(away < 1.96 * mesh.deviation) > 0.93
    touched = mesh.deviation < 0.03e-3
    assert away[touched].mean() < 0.015e-3
    outwards = (mesh.vertices - CENTER) / RADIUS
    angle = np.degrees(np.arccos(np.clip(np.sum(mesh.normal * outwards, axis=1), -1, 1)))
    assert np.median(angle[touched]) < 0.3
    assert not shape.warnings
