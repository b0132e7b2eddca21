"""A sweep as a film."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from matplotlib import animation as mpl_animation
from matplotlib import pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from PIL import Image

from vibrissa.forward import Scan
from vibrissa.inverse import Reconstruction
from vibrissa.plot.arguments import checked
from vibrissa.plot.scene import Shown, draw_moving, known, lines, shown_of, staged
from vibrissa.plot.space import Stage
from vibrissa.surfaces import Surface

_RATE = 20
"""Frames per second: smooth to the eye, and a delay that GIF, in hundredths of a second, can
hold."""
_DPI = 150
_MARGIN = 12
"""White rim [pixel]."""
_LEARNT = 8
"""Frames from which the colours of a GIF are taken."""
_WIDTH = 1.6
"""Of the rod [pt]: there is only one."""
_WRITERS = {".gif": "pillow", ".webp": "pillow", ".mp4": "ffmpeg"}


@checked
def animation(
    what: Scan | Reconstruction,
    path: str | Path,
    *,
    surface: Surface | None = None,
    trails: Sequence[int] | None = None,
    seconds: float = 6.0,
    box: tuple[Sequence[float], Sequence[float]] | None = None,
    view: tuple[float, float] | None = None,
) -> Path:
    """Write a film of the sweep: the rod at one position after the other, trail by trail, and the
    contacts that it leaves; colours and object as in `scene`.

    Parameters
    ----------
    what
        Scan or reconstruction.
    path
        File to write: GIF or WebP, or MP4 where the program ffmpeg is installed. Folders that do
        not exist are made.
    surface
        Object, in units of the rod; by default that of a scan.
    trails
        Which of several trails are shown; by default all.
    seconds
        How long the film runs, at 20 frames per second, at most one for each position.
    box, view
        As for `scene`.

    Raises
    ------
    TypeError
        If `what` is something else.
    ValueError
        If the path has another suffix, `seconds` is not positive, MP4 is asked for without ffmpeg,
        or there is nothing to draw.
    ImportError
        If the object cannot be drawn without `vibrissa[mesh]`, and that is not installed.
    """
    path = Path(path)
    writer = _WRITERS.get(path.suffix.lower())
    if writer is None:
        raise ValueError(f"path = {path}: allowed suffixes are {', '.join(_WRITERS)}")
    if not mpl_animation.writers.is_available(writer):
        raise ValueError(f"path = {path}: MP4 needs the program ffmpeg; .gif and .webp need none")
    if not 0 < seconds < np.inf:
        raise ValueError(f"seconds = {seconds}; allowed is more than 0")
    surface = surface or (what.surface if isinstance(what, Scan) else None)
    shown = shown_of(what, what.rod, trails, rods=20, directions=False)
    stage, around = staged(shown, what.rod, surface, box, view)
    fixed = set(stage.axes.get_children())
    draw_moving(stage, shown)
    stage.framed(around)
    for artist in set(stage.axes.get_children()) - fixed - {stage.axes.get_legend()}:
        artist.remove()
    frames = _cropped(_frames(stage, what, trails, shown, max(2, round(seconds * _RATE))))
    plt.close(stage.axes.get_figure(root=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    if writer == "pillow":
        _save_pictures(frames, path)
    else:
        _save_film(frames, path)
    return path


def _save_pictures(frames: UInt8[np.ndarray, "frame row column 3"], path: Path) -> None:
    pictures = [Image.fromarray(frame) for frame in frames]
    if path.suffix.lower() == ".gif":
        # One set of 256 colours for all frames: a set for each changes the colours of thin lines.
        some = np.concatenate(frames[:: max(1, len(frames) // _LEARNT)])
        colours = Image.fromarray(some).quantize(256, kmeans=2)
        plain = Image.Dither.NONE
        pictures = [one.quantize(palette=colours, dither=plain) for one in pictures]
    first, *others = pictures
    delay = round(1000 / _RATE)
    first.save(path, save_all=True, append_images=others, duration=delay, loop=0)


def _save_film(frames: UInt8[np.ndarray, "frame row column 3"], path: Path) -> None:
    height, width = frames.shape[1:3]
    film = plt.figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI)
    pictures = [[film.figimage(frame)] for frame in frames]
    running = mpl_animation.ArtistAnimation(film, pictures, interval=1000 / _RATE)
    running.save(path, writer="ffmpeg", dpi=_DPI)
    plt.close(film)


def _frames(
    stage: Stage,
    what: Scan | Reconstruction,
    trails: Sequence[int] | None,
    shown: Shown,
    count: int,
) -> UInt8[np.ndarray, "frame row column 3"]:
    """What one sees at rows equally spaced over the trails, one after the other.

    Nothing that moves is behind the object: it is drawn once.
    """
    order = np.arange(what.kind.size).reshape(what.kind.shape)
    passed = np.ravel(order if trails is None or order.ndim == 1 else order[list(trails)])
    figure = stage.axes.get_figure(root=True)
    assert figure is not None
    figure.set_dpi(_DPI)
    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    background = canvas.copy_from_bbox(figure.bbox)
    fixed, frames = set(stage.axes.get_children()), []
    for k in np.unique(np.linspace(0, len(passed) - 1, count).round().astype(int)):
        canvas.restore_region(background)
        so_far, now = np.isin(order, passed[: k + 1]), order == passed[k]
        now &= np.isfinite(what.energy)
        touched = known(what.contacts, so_far & what.in_contact)
        rod = lines(what, now)._replace(width=_WIDTH)
        draw_moving(stage, shown._replace(contacts=touched, rods=rod))
        moving = sorted(set(stage.axes.get_children()) - fixed, key=lambda one: one.get_zorder())
        for artist in moving:
            if isinstance(artist, Line3DCollection):
                artist.do_3d_projection()
            stage.axes.draw_artist(artist)
            artist.remove()
        frames.append(np.array(canvas.buffer_rgba())[..., :3])
    return np.array(frames)


def _cropped(frames: UInt8[np.ndarray, "frame row column 3"]) -> UInt8[np.ndarray, "f r c 3"]:
    """Without what is white in all frames, but for a rim; of even size, as MP4 wants it."""
    dark = np.any(frames < 255, axis=(0, 3))
    sides = []
    for axis in (1, 0):
        used = np.flatnonzero(np.any(dark, axis=axis))
        first, last = max(used[0] - _MARGIN, 0), min(used[-1] + _MARGIN, dark.shape[1 - axis])
        sides.append(slice(first, last - (last - first) % 2))
    return frames[:, sides[0], sides[1]]
