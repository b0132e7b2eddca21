"""The forward problem: rod, object and clamp path in, support reactions out."""

from vibrissa.scan.equilibria import Equilibrium, equilibria
from vibrissa.scan.events import Event, EventKind
from vibrissa.scan.result import Scan
from vibrissa.scan.scan import scan
from vibrissa.scan.slip import Slip
from vibrissa.scan.validity import QuasiStatic

__all__ = ["Equilibrium", "Event", "EventKind", "QuasiStatic", "Scan", "Slip", "equilibria", "scan"]
