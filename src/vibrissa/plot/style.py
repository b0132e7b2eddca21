"""How all figures look: journal sizes, readable without colour."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, Int
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import Axes3D, proj3d

from vibrissa.contacts import Status
from vibrissa.rod import Rod

AXIS_COLOURS = ("#d55e00", "#009e73", "#0072b2")
"""x, y and z, told apart by colour-blind readers too (Okabe and Ito)."""

COLUMN, PAGE = 3.5, 6.3
"""Widths of a journal's column and of the text on an A4 page [inch]: on a slide, at three quarters
of the latter, letters are still 7 points high.
"""

SUFFIXES = (".png", ".pdf", ".svg")
_METADATA: dict[str, dict[str, None]] = {
    ".png": {},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
_MOST_STATUSES = 3

_SETTINGS: dict[Any, Any] = {
    "font.family": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 10,
    "axes.labelsize": 10,
    "axes.titlesize": 10,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
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


def save(axes: Axes | Sequence[Axes], folder: str | Path, name: str) -> list[Path]:
    """Write the figure of some axes as PNG and as PDF, and close it; return both paths."""
    return [save_as(axes, Path(folder) / f"{name}.{suffix}") for suffix in ("png", "pdf")]


def save_as(axes: Axes | Sequence[Axes], path: str | Path) -> Path:
    """Write the figure of some axes in the format of the path's suffix, and close it. Folders that
    do not exist are made.

    Raises
    ------
    ValueError
        If the suffix is not .png, .pdf or .svg.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ValueError(f"{path}: suffix {path.suffix!r}; allowed are {', '.join(SUFFIXES)}")
    figure = np.ravel(np.asarray(axes, dtype=object))[0].get_figure(root=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without a date and random names the same figure gives the same file.
    with mpl.rc_context({"svg.hashsalt": "vibrissa"}):
        shown = _shown(figure) if all(one.name == "3d" for one in figure.axes) else "tight"
        figure.savefig(path, bbox_inches=shown, pad_inches=0.04, metadata=_METADATA[suffix])
    plt.close(figure)
    return path


def corners_of(axes: Axes3D) -> Float[np.ndarray, "8 2"]:
    """Where the corners of axes in space are on the canvas [pixel]."""
    limits = np.meshgrid(axes.get_xlim(), axes.get_ylim(), axes.get_zlim())
    across, up, _ = proj3d.proj_transform(*np.reshape(limits, (3, -1)), axes.get_proj())
    return np.asarray(axes.transData.transform(np.column_stack([across, up])))


def _shown(figure: Figure) -> Bbox:
    """What a figure in space shows [inch]: the square of its axes, which a tight box would keep,
    is mostly empty.
    """
    figure.canvas.draw()
    boxes = []
    for axes in figure.axes:
        legend = axes.get_legend()
        boxes += [axis.get_tightbbox() for axis in axes._axis_map.values()]
        boxes += [legend.get_window_extent()] if legend else []
        boxes.append(Bbox(np.quantile(corners_of(axes), [0, 1], axis=0)))
    around = Bbox.union([box for box in boxes if box is not None])
    return around.transformed(figure.dpi_scale_trans.inverted()).padded(0.04)


def status_words(status: Int[np.ndarray, "..."]) -> str:
    """Statuses in words with their counts, the most frequent first: a label of a legend."""
    codes, counts = np.unique(status, return_counts=True)
    order = np.argsort(-counts, kind="stable")
    named = order[: _MOST_STATUSES if len(order) > _MOST_STATUSES + 1 else len(order)]
    words = [f"{Status(int(codes[i])).name.lower().replace('_', ' ')} ({counts[i]})" for i in named]
    if len(named) < len(order):
        words.append(f"other findings ({counts[order[len(named) :]].sum()})")
    return ", ".join(words)


def no_contact(status: Int[np.ndarray, "..."], rows: str) -> ValueError:
    """Return the error of a figure without any contact; it counts the `rows` by status."""
    codes, counts = np.unique(status, return_counts=True)
    said = [f"{n} {Status(int(code)).name}" for code, n in zip(codes, counts, strict=True)]
    return ValueError(
        f"nothing to draw: no contact in {status.size} {rows} ({', '.join(said)}); allowed is at "
        "least one"
    )


def length_label(symbol: str, rod: Rod) -> str:
    """Axis label of a length: millimetres for SI rods, rod lengths in the model's units."""
    return f"${symbol}$ [mm]" if rod.units == "SI" else f"${symbol}/L$"
