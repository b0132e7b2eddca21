"""The paper, end to end: its case, its statements, its figures."""

from vibrissa.paper.demo import Demo, run_demo
from vibrissa.paper.statements import Statement

__all__ = ["Demo", "Statement", "run_demo"]
