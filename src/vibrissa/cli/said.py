"""What a recording says against its setup while a command works: for `--json`, beside the lines on
stderr.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def listening() -> Iterator[list[str]]:
    """Give the list of the lines of `RecordingWarning`, each once, that grows as they come; they
    are shown as before. Notes of reading are none of them.
    """
    from vibrissa.contacts import RecordingNote, RecordingWarning  # noqa: PLC0415

    lines: list[str] = []
    before = warnings.showwarning

    def show(
        message: Warning | str, category: type[Warning], *place: object, **more: object
    ) -> None:
        line = " ".join(str(message).split())
        if (
            issubclass(category, RecordingWarning)
            and not issubclass(category, RecordingNote)
            and line not in lines
        ):
            lines.append(line)
        before(message, category, *place, **more)  # type: ignore[arg-type]

    warnings.showwarning = show
    try:
        yield lines
    finally:
        warnings.showwarning = before
