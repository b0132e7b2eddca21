"""Progress on stderr: a spinner on a terminal, a line a step elsewhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def reporting() -> Iterator[Callable[[str], None]]:
    """Give a function that reports the name of the step that begins."""
    from rich.console import Console  # noqa: PLC0415

    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield lambda step: console.print(step, soft_wrap=True, markup=False)
        return
    with console.status("starting") as status:
        yield status.update
