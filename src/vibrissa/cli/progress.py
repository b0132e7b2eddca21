"""Progress: a spinner, a bar and the time left on stderr if that is a terminal, else nothing."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass


@dataclass(frozen=True)
class Steps:
    """Called with the name of a step as it begins; `count` tells how many of them are done."""

    begin: Callable[[str], None]
    count: Callable[[int, int], None]

    def __call__(self, step: str) -> None:
        """Begin a step."""
        self.begin(step)


@contextmanager
def reporting() -> Iterator[Steps]:
    """Give a reporter for the steps of a command."""
    from rich.console import Console  # noqa: PLC0415

    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield Steps(lambda _: None, lambda *_: None)
        return
    from rich.progress import (  # noqa: PLC0415
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.table import Column  # noqa: PLC0415

    columns = (
        SpinnerColumn(),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(max_width=44, no_wrap=True, overflow="ellipsis"),
        ),
        BarColumn(bar_width=16),
        TimeElapsedColumn(),
        TimeRemainingColumn(compact=True),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("starting", total=None)
        yield Steps(
            lambda step: bar.reset(task, description=step, total=None),
            lambda done, total: bar.update(task, completed=done, total=total),
        )
