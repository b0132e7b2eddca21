"""Frames and rotations: a thin layer over SciPy's, in the project's conventions."""
