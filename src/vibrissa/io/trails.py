"""Motions of the clamp as TOML tables [[trail]]: the arguments of a trail."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from vibrissa.io.config import Boolean, Finite, Quaternion, Table, Vector, number, one_of, table_of
from vibrissa.trail import Trail

Count = Annotated[int, number("a whole number of at least 1", ge=1)]


class MotionTable(Table):
    """Where the clamp goes; one orientation in a list holds for all positions."""

    def arguments(self, folder: Path) -> dict[str, Any]:
        """Keys of the table, a single orientation out of its list."""
        given = super().arguments(folder)
        for name in given.keys() & {"orientation", "orientations"}:
            given[name] = given[name][0] if len(given[name]) == 1 else given[name]
        return given


def _several(of: Any, least: int, description: str) -> Any:
    return Annotated[tuple[of, ...], Field(min_length=least, description=description)]


_TURNS = _several(Quaternion, 1, "a list of one quaternion x, y, z, w, or one for each position")
_TYPES = {
    **dict.fromkeys(("start", "stop", "axis", "step", "center", "rod_axis", "pivot"), Vector),
    **dict.fromkeys(("count", "trails"), Count),
    **dict.fromkeys(("angle", "start_angle", "stop_angle"), Finite),
    "position": Vector,
    "orientation": Quaternion,
    "orientations": _TURNS,
    "turning": Boolean,
    "points": _several(Vector, 2, "a list of at least two way-points of three finite numbers"),
    "path": Annotated[
        Path, Field(description="the path of a CSV file, seen from the case's folder")
    ],
}
_POSES = {
    "position": _several(Vector, 1, "a list of at least one position of three finite numbers"),
    "orientation": _TURNS,
}
_KINDS: dict[str, Callable[..., Any]] = {
    "line": Trail.line,
    "raster": Trail.raster,
    "poses": Trail,
    "arc": Trail.arc,
    "whisk": Trail.whisk,
    "spline": Trail.spline,
    "csv": Trail.from_csv,
}
TrailTable = one_of(
    table_of(noun, _TYPES | (_POSES if kind == "poses" else {}), kind, MotionTable)
    for kind, noun in _KINDS.items()
)
