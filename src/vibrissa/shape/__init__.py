"""From contacts towards the surface."""

from vibrissa.shape.coverage import coverage

__all__ = ["coverage"]
