"""What the figure of contacts shows: all of them, or why there is none."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot as plt

import vibrissa as vb
from vibrissa import plot

FOLDER = Path(__file__).parents[2] / "examples/recordings/sphere_60mm"


@pytest.fixture(scope="module")
def found() -> vb.Reconstruction:
    setup = vb.load_setup(FOLDER / "setup.toml")
    return vb.reconstruct(setup.rod, vb.read_recording(FOLDER / "trail.csv", setup))


def drawn(found: vb.Reconstruction) -> tuple[str, dict[str, int], np.ndarray]:
    """Title and labels of the legend, with the points in the first panel by label, and the frame of
    that panel.
    """
    mpl.use("Agg")
    panels = plot.contacts_figure(found)
    figure = panels[0].get_figure(root=True)
    assert figure is not None
    figure.canvas.draw()
    legend, frame = figure.legends[0], np.array([panels[0].get_xlim(), panels[0].get_ylim()])
    counts = {str(line.get_label()): len(line.get_xdata()) for line in panels[0].lines}
    assert [text.get_text() for text in legend.get_texts()] == list(counts)
    title = legend.get_title().get_text()
    plt.close(figure)
    return title, counts, frame


def test_every_contact_is_drawn_by_how_far_it_can_be_trusted(found: vb.Reconstruction) -> None:
    """Few of a good recording are wide; of one whose noise were forty times as large all are, and
    they fill the same place.
    """
    assert found.covariance is not None
    _, counts, frame = drawn(found)
    assert sum(counts.values()) == np.count_nonzero(found.in_contact)
    assert sum(count for label, count in counts.items() if "deviation above 2.5 mm" in label) < 100
    _, noisy, same = drawn(replace(found, covariance=1600 * found.covariance))
    assert sum(count for label, count in noisy.items() if "deviation above 2.5 mm" in label) == sum(
        counts.values()
    )
    np.testing.assert_allclose(same, frame, atol=10)


def test_statuses_are_crosses_and_an_empty_figure_says_why(found: vb.Reconstruction) -> None:
    contacts = np.count_nonzero(found.in_contact)
    _, counts, frame = drawn(
        replace(found, status=np.full_like(found.status, vb.Status.SETUP_CONTRADICTED))
    )
    assert counts == {f"status not OK ({contacts})": contacts}
    assert np.all(np.diff(frame) < 100)
    title, counts, _ = drawn(
        replace(
            found,
            point=np.full_like(found.point, np.nan),
            status=np.full_like(found.status, vb.Status.BAD_DATA),
        )
    )
    assert title == "no contact in 901 samples; 901 BAD_DATA"
    assert counts == {"path of the clamp, no contact": 901}
