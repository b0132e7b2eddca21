"""Frames and rotations: a thin layer over the library's, in the project's conventions."""
