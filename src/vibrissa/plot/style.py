"""How all figures look: journal sizes, readable without colour."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from vibrissa.contacts import ContactKind
from vibrissa.rod import Rod

KIND_COLOURS = {ContactKind.TIP: "#c1121f", ContactKind.TANGENTIAL: "#1d5fa8"}
"""Tip contact red, tangential contact blue (paper, figure 3)."""
KIND_NAMES = {ContactKind.TIP: "tip contact", ContactKind.TANGENTIAL: "tangential contact"}

COLUMN, PAGE = 3.5, 7.2
"""Widths of one and of two journal columns [inch]."""

_SETTINGS: dict[Any, Any] = {
    "font.family": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "savefig.dpi": 300,
    "figure.dpi": 150,
    "pdf.fonttype": 42,
}


@contextmanager
def journal() -> Iterator[None]:
    """Set the style of figures made within."""
    # Only these are put back: a notebook's backend has settings of its own, made with its first
    # figure, without which it shows no further ones.
    before = {name: mpl.rcParams[name] for name in _SETTINGS}
    mpl.rcParams.update(_SETTINGS)
    try:
        yield
    finally:
        mpl.rcParams.update(before)


def save(axes: Axes | Sequence[Axes], folder: Path, name: str) -> list[Path]:
    """Write the figure of some axes as PNG and as PDF, and close it; return both paths."""
    return [save_as(axes, folder / f"{name}.{suffix}") for suffix in ("png", "pdf")]


def save_as(axes: Axes | Sequence[Axes], path: Path) -> Path:
    """Write the figure of some axes in the format of the path's suffix, and close it."""
    figure = np.ravel(np.asarray(axes, dtype=object))[0].get_figure(root=True)
    # Without a date in its metadata the same figure gives the same file.
    dateless = {"CreationDate": None} if path.suffix == ".pdf" else None
    figure.savefig(path, bbox_inches="tight", pad_inches=0.04, metadata=dateless)
    plt.close(figure)
    return path


def length_label(symbol: str, rod: Rod) -> str:
    """Axis label of a length: millimetres for SI rods, rod lengths in the model's units."""
    return f"${symbol}$ [mm]" if rod.units == "SI" else f"${symbol}/L$"


def length_factor(rod: Rod) -> float:
    """Factor by which lengths are multiplied for `length_label`."""
    return 1e3 if rod.units == "SI" else 1.0
