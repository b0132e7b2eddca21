"""Figures of common six-axis sensors, from their makers' sheets.

Each preset holds ranges, resolution and noise. Where a sheet states no noise, one step of its
resolution is taken as the standard deviation: the resolution that a sheet states is what the maker
calls discernible in the noise, so that the noise is of that size at most.

ATI Nano17, calibrations SI-12-0.12, SI-25-0.25 and SI-50-0.5
    ATI Industrial Automation, product page "F/T Sensor: Nano17", tables "Sensing ranges" and
    "Resolution" (typical, with a 16-bit data acquisition system). Noise is not stated.
ATI Mini40, calibration SI-40-2, and ATI Mini45, calibration SI-145-5
    ATI Industrial Automation, product pages "F/T Sensor: Mini40" and "F/T Sensor: Mini45", the same
    tables, as laboratories that measured theirs against them quote them. At rest they found,
    without a filter, 0.7 to 1.6 times these forces and 1.2 to 2.2 times these torques (Mini40, 1
    kHz), and a third of the lateral forces, 0.8 of the axial force, 0.4 and 0.75 of the torques
    (Mini45, 2 kHz): the resolution is the noise of the strain gauges, not the converter's step.
ATI Axia80-M20, calibration SI-500-20
    ATI Industrial Automation, "Manual, F/T Sensor, Ethernet Axia", document 9610-05-Ethernet
    Axia-09, table 4.8: the ranges alone. Resolution and noise are not in what we have seen of it,
    and have to be given.
Robotiq FT 300-S
    Robotiq, "FT 300-S Force Torque Sensor Instruction Manual": range, data stream at 100 Hz in
    steps of 0.01 N and 0.001 N m. Signal noise as in the maker's data sheet: 0.1 N, 0.005 N m; the
    figure of tx and ty is taken for tz too.
"""

from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from vibrissa.sensor.sensor import Sensor, WrenchSign

_Axes = tuple[float, float, float]
_Figures = dict[str, float | _Axes]


def _of_resolution(
    force_range: _Axes, torque_range: _Axes, force: float | _Axes, torque: float | _Axes
) -> _Figures:
    return {
        "force_range": force_range,
        "torque_range": torque_range,
        "force_resolution": force,
        "torque_resolution": torque,
        "force_noise": force,
        "torque_noise": torque,
    }


def _nano17(scale: float) -> _Figures:
    """Ranges and resolutions of the three calibrations are as 1 to 2 to 4, but for the rounded
    ranges of SI-12-0.12.
    """
    force, along, torque = {1: (12.0, 17.0, 0.12), 2: (25.0, 35.0, 0.25), 4: (50.0, 70.0, 0.5)}[
        int(scale)
    ]
    step, turn = scale / 320, scale * 1e-3 / 64
    return _of_resolution((force, force, along), (torque, torque, torque), step, turn)


PRESETS: MappingProxyType[str, _Figures] = MappingProxyType(
    {
        "ati_nano17_si_12_0_12": _nano17(1),
        "ati_nano17_si_25_0_25": _nano17(2),
        "ati_nano17_si_50_0_5": _nano17(4),
        "ati_mini40_si_40_2": _of_resolution(
            (40.0, 40.0, 120.0), (2.0, 2.0, 2.0), (1 / 100, 1 / 100, 1 / 50), 1 / 4000
        ),
        "ati_mini45_si_145_5": _of_resolution(
            (145.0, 145.0, 290.0), (5.0, 5.0, 5.0), 1 / 16, (1 / 752, 1 / 752, 1 / 1504)
        ),
        "ati_axia80_m20_si_500_20": {
            "force_range": (500.0, 500.0, 900.0),
            "torque_range": (20.0, 20.0, 20.0),
        },
        "robotiq_ft_300_s": {
            "force_range": (300.0, 300.0, 300.0),
            "torque_range": (30.0, 30.0, 30.0),
            "force_resolution": 0.01,
            "torque_resolution": 0.001,
            "force_noise": 0.1,
            "torque_noise": 0.005,
        },
    }
)
"""Figures by the name of the sensor and its calibration: fields of `Sensor`, SI units."""


def preset_figures(name: str) -> _Figures:
    """Fields of `Sensor` that a preset gives; none for the empty name.

    Raises
    ------
    ValueError
        If there is no such preset.
    """
    if name and name not in PRESETS:
        raise ValueError(f"preset = {name!r}; allowed are {', '.join(PRESETS)}")
    return dict(PRESETS[name]) if name else {}


def preset(
    name: str,
    *,
    clamp_position: ArrayLike = (0.0, 0.0, 0.0),
    clamp_orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
    wrench: "WrenchSign" = "on_sensor",
) -> "Sensor":
    """A sensor with the figures of a preset; `dataclasses.replace` changes them.

    Parameters
    ----------
    name
        One of `PRESETS`.
    clamp_position, clamp_orientation, wrench
        As for `Sensor`.

    Raises
    ------
    ValueError
        If there is no such preset, or as for `Sensor`.
    """
    from vibrissa.sensor.sensor import Sensor  # noqa: PLC0415

    known: dict[str, Any] = dict(preset_figures(name))
    return Sensor(
        np.asarray(clamp_position, dtype=float),
        np.asarray(clamp_orientation, dtype=float),
        wrench,
        **known,
    )
