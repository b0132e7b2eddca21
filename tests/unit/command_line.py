"""The command line in this process, which has its kernels already."""

import os
import sys
from typing import NamedTuple

import pytest

from vibrissa.cli import main


class Run(NamedTuple):
    """How a command ended, and what it said."""

    status: int
    out: str
    err: str


def status_of(*arguments: object) -> int:
    """Exit status of `vibrissa` with these arguments."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.setattr(sys, "argv", ["vibrissa", *map(str, arguments)])
        patch.setattr(os, "environ", dict(os.environ))
        main()
    return int(ended.value.code or 0)


def vibrissa(capsys: pytest.CaptureFixture[str], *arguments: object) -> Run:
    """Run `vibrissa` with these arguments."""
    capsys.readouterr()
    return Run(status_of(*arguments), *capsys.readouterr())
