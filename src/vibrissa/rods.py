"""Rods with published numbers: wires of common materials, and the whiskers of the laboratory rat.

Moduli are of the material in general: where stiffness matters to better than 5 %, calibrate.
"""

from vibrissa.rod import RestShape, Rod, Thermal

__all__ = ["nitinol", "rat_whisker", "spring_steel"]

_STEEL, _STEEL_SHEAR = 206e9, 81.5e9
_WHISKERS = {
    "A": ((39.9, 5.96), (31.0, 11.8), (25.1, 12.3), (15.4, 17.8), (10.7, 22.2)),
    "B": ((46.8, 6.81), (40.8, 9.14), (29.3, 14.9), (20.7, 16.6), (11.8, 24.4)),
    "C": (
        (52.8, 6.94),
        (45.2, 8.85),
        (32.6, 11.8),
        (22.9, 13.6),
        (13.3, 23.3),
        (7.68, 18.5),
        (4.4, 38.1),
    ),
    "D": (
        (52.6, 8.09),
        (45.9, 8.59),
        (35.3, 10.4),
        (25.5, 13.0),
        (17.1, 17.8),
        (10.9, 23.9),
        (6.62, 26.4),
    ),
    "E": (None, (44.1, 10.1), (34.6, 10.1), (24.4, 14.2), (15.5, 22.4), (9.4, 19.2), (7.13, 17.7)),
}
"""Arc length [mm] and a [1/m] of the parabola y = a x² by row and column: see `rat_whisker`."""
_LEAST_TIP = 1.5e-6  # radius [m]; tips measured to be finer than that are few


def spring_steel(length: float, radius: float) -> Rod:
    """Patented cold-drawn spring steel wire: E = 206 GPa, G = 81.5 GPa, 7850 kg/m³ (EN 10270-1, as
    wire makers' data sheets quote it).

    Its yield strain, 0.8 %, is the low end for hard-drawn wire; E by −2.8e-4/K and expansion by
    11.5e-6/K are rounded values of carbon steels in general, not of this standard. SI units, as
    `Rod.cylinder`; errors likewise.
    """
    return Rod.cylinder(
        length=length,
        radius=radius,
        youngs_modulus=_STEEL,
        density=7850.0,
        poisson_ratio=_STEEL / (2 * _STEEL_SHEAR) - 1,
        yield_strain=0.008,
        thermal=Thermal(modulus_slope=-2.8e-4, expansion=11.5e-6),
    )


def nitinol(length: float, radius: float, *, youngs_modulus: float = 75e9) -> Rod:
    """Superelastic nickel-titanium wire as austenite: 75 to 83 GPa, ν = 0.33, 6450 kg/m³ (makers'
    data sheets: Memry; SMA Inc., Selected Properties of NiTi).

    Composition and drawing move the modulus by tens of per cent: give that of your wire. From about
    1 % strain on, stated as its yield strain, stress is not proportional to strain. Its modulus
    is not linear in the temperature near the transformation, so none is given. SI units, as
    `Rod.cylinder`; errors likewise.
    """
    return Rod.cylinder(
        length=length,
        radius=radius,
        youngs_modulus=youngs_modulus,
        density=6450.0,
        poisson_ratio=0.33,
        yield_strain=0.01,
    )


def rat_whisker(
    *,
    row: str | int,
    column: int,
    youngs_modulus: float = 3.34e9,
    density: float = 1180.0,
) -> Rod:
    """A mystacial whisker of the laboratory rat: a straight taper, curved as a parabola (roll 0).

    Parameters
    ----------
    row
        "A" (dorsal) to "E", or 1 to 5.
    column
        From 0, the Greek arc (caudal), to 4 in rows A and B, 6 in C and D; 1 to 6 in row E.
    youngs_modulus
        [Pa]; by default the mean of 22 whiskers in tension, 3.34 ± 1.48 GPa (B. W. Quist et al.,
        Journal of Biomechanics 44 (2011) 2775-2781; 2.90 GPa near the base, 3.96 near the tip).
    density
        Mass by the volume of the truncated cone [kg/m³]; by default the mean of 23 whiskers of
        dataset 7 in supplemental table 1 of Belli et al. 2016.

    Notes
    -----
    Arc length and a of y = a x² are means of rats (H. M. Belli et al., PLoS ONE 13 (2018) e0194981,
    as WHISKiT Physics distributes them, `whisker_param_average_rat`). Diameter at the base, 0.041 +
    0.0020 S + 0.011 row − 0.0039 column [mm], and slope of the radius, 0.0012 + 0.00017 row −
    0.000066 column + 0.00011 column², with the arc length S [mm] and rows from 1: fits to over 500
    whiskers (H. M. Belli et al., Journal of Neurophysiology 117 (2017) 1807-1820). Tip radii that
    follow scatter about zero: they are at least 1.5 µm here. The medulla, a hollow that takes less
    than 1 % of the stiffness at the base (A. E.-T. Yang et al., Journal of Neurophysiology 121
    (2019) 1879-1895), is left out; Poisson's ratio, 0.38, is assumed, as of keratin.

    Raises
    ------
    ValueError
        If there is no such whisker.
    """
    rows = list(_WHISKERS)
    name = rows[row - 1] if row in range(1, len(rows) + 1) else row  # type: ignore[operator]
    if name not in rows:
        raise ValueError(f"row = {row!r}; allowed are A, B, C, D and E, or 1 to 5")
    known = {place: one for place, one in enumerate(_WHISKERS[str(name)]) if one is not None}
    if column not in known:
        raise ValueError(
            f"column = {column!r}; allowed in row {name} is {min(known)} to {max(known)}"
        )
    size, a = known[column]
    number = 1 + rows.index(str(name))
    base = (0.041 + 0.0020 * size + 0.011 * number - 0.0039 * column) / 2
    slope = 0.0012 + 0.00017 * number - 0.000066 * column + 0.00011 * column**2
    return Rod.tapered(
        length=1e-3 * size,
        base_radius=1e-3 * base,
        tip_radius=max(1e-3 * (base - slope * size), _LEAST_TIP),
        youngs_modulus=youngs_modulus,
        density=density,
        poisson_ratio=0.38,
    ).curved(RestShape.parabola(a))
