"""Figures, one a function. The only room that knows matplotlib."""

from vibrissa.plot.calibration import (
    parameter_correlation,
    residual_histogram,
    residuals_over_force,
    residuals_over_time,
)
from vibrissa.plot.contacts import contacts_figure
from vibrissa.plot.coverage import coverage_figure
from vibrissa.plot.design import expected_error_map
from vibrissa.plot.events import reactions_along
from vibrissa.plot.lines import contact_sequences, elastic_lines
from vibrissa.plot.reactions import reactions_over_plane
from vibrissa.plot.recording import recording_figure
from vibrissa.plot.style import journal, save, save_as

__all__ = [
    "contact_sequences",
    "contacts_figure",
    "coverage_figure",
    "elastic_lines",
    "expected_error_map",
    "journal",
    "parameter_correlation",
    "reactions_along",
    "reactions_over_plane",
    "recording_figure",
    "residual_histogram",
    "residuals_over_force",
    "residuals_over_time",
    "save",
    "save_as",
]
