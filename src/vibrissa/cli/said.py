"""What a recording says against its setup while a command works: for `--json`, beside the lines on
stderr.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


def one_line(message: Warning | str) -> str:
    """Text of a warning."""
    return " ".join(str(message).split())


def of_setup(category: type[Warning]) -> bool:
    """Whether a warning says that a recording contradicts its setup: `RecordingWarning`, but no
    note of reading.
    """
    from vibrissa.contacts import RecordingNote, RecordingWarning  # noqa: PLC0415

    return issubclass(category, RecordingWarning) and not issubclass(category, RecordingNote)


@contextmanager
def listening() -> Iterator[list[str]]:
    """Give the list of the lines of `RecordingWarning`, each once, that grows as they come; they
    are shown as before.
    """
    lines: list[str] = []
    before = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
        line = one_line(message)
        if of_setup(category) and line not in lines:
            lines.append(line)
        before(message, category, *place, **more)

    warnings.showwarning = show
    try:
        yield lines
    finally:
        warnings.showwarning = before
