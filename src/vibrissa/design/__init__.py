"""Before anything is built: how well a sensor will locate the contacts of a scene."""

from vibrissa.design.expected import ExpectedError, expected_error

__all__ = ["ExpectedError", "expected_error"]
