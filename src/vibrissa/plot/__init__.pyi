from .animation import animation
from .calibration import (
    parameter_correlation,
    residual_histogram,
    residuals_over_force,
    residuals_over_time,
)
from .contacts import contacts_figure
from .coverage import coverage_figure
from .design import expected_error_map
from .events import reactions_along
from .reactions import reactions_over_plane
from .recording import recording_figure
from .scene import scene
from .shapes import comparison_figure, shape_figure
from .style import journal, save, save_as

__all__ = [
    "animation",
    "comparison_figure",
    "contacts_figure",
    "coverage_figure",
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
    "scene",
    "shape_figure",
]
