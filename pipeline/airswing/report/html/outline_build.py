"""Build the shipped map outline from Natural Earth and US Census TopoJSON files.

Assumptions and validity: the inputs are ``countries-50m.json`` of the npm package
``world-atlas`` (Natural Earth 1:50m, public domain) and ``states-10m.json`` of
``us-atlas`` (US Census Bureau cartographic boundaries, public domain), both unprojected
longitude and latitude in degrees.  Run once by a developer; never at run time::

    npm pack world-atlas us-atlas
    python -m airswing.report.html.outline_build countries-50m.json states-10m.json outline.npz

In a topology an arc used by one country is coast, by two a border.  US state shores are
kept only around the Great Lakes, which Natural Earth's land polygons leave out.  Lines are
thinned (Douglas and Peucker 1973) and stored as whole hundredths of a degree.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NotRequired, TypeAlias, TypedDict

import numpy as np

# 180 degrees in hundredths fit int16, and no map shows finer.
_HUNDREDTHS = 100.0
# West, east, south, north, degrees.
_GREAT_LAKES = (-93.0, -75.5, 41.2, 49.1)
# Degrees a line may move; states and lakes are looked at from nearer.
_THINNING = {"coast": 0.04, "border": 0.03, "state": 0.02, "lake": 0.02}

# Numbers of arcs; negative ones are run through backwards.
Nested: TypeAlias = "int | Sequence[Nested]"


class Geometry(TypedDict):
    """A country or a state."""

    arcs: NotRequired[Nested]


class Collection(TypedDict):
    """All countries, or all states."""

    geometries: list[Geometry]


class Transform(TypedDict):
    """What whole numbers of a topology are multiplied by, and what is added."""

    scale: list[float]
    translate: list[float]


class Topology(TypedDict):
    """As much of a TopoJSON file as is looked at."""

    transform: Transform
    arcs: list[list[list[int]]]
    objects: dict[str, Collection]


def _decoded_arcs(topology: Topology) -> list[np.ndarray]:
    """Return every arc of a quantised topology as an (n, 2) array of degrees east, north."""
    scale = np.array(topology["transform"]["scale"])
    shift = np.array(topology["transform"]["translate"])
    return [np.cumsum(np.array(arc), axis=0) * scale + shift for arc in topology["arcs"]]


def _flat(indices: Nested) -> Iterator[int]:
    if isinstance(indices, int):
        yield indices if indices >= 0 else ~indices
        return
    for part in indices:
        yield from _flat(part)


def _arc_uses(geometries: Iterable[Geometry]) -> Counter[int]:
    """Count, for each arc, how many geometries use it (1: shore, 2: border)."""
    uses: Counter[int] = Counter()
    for geometry in geometries:
        uses.update(set(_flat(geometry.get("arcs", []))))
    return uses


def thinned(line: np.ndarray, tolerance: float) -> np.ndarray:
    """Thin a line, keeping every dropped point within a tolerance of what is left.

    Parameters
    ----------
    line : array (n, 2)
        Points, degrees.
    tolerance : float
        Greatest distance of a dropped point from the kept line, degrees.

    Returns
    -------
    array (m, 2)
        The points kept, first and last always among them.
    """
    keep = np.zeros(len(line), bool)
    keep[[0, -1]] = True
    stack = [(0, len(line) - 1)]
    while stack:
        first, last = stack.pop()
        if last - first < 2:
            continue
        chord = line[last] - line[first]
        inside = line[first + 1 : last] - line[first]
        length = float(np.hypot(*chord))
        if length > 0:
            away = np.abs(inside[:, 0] * chord[1] - inside[:, 1] * chord[0]) / length
        else:
            away = np.hypot(inside[:, 0], inside[:, 1])
        worst = int(np.argmax(away))
        if away[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            stack += [(first, middle), (middle, last)]
    return line[keep]


def _selected_lines(world: Topology, states: Topology) -> dict[str, list[np.ndarray]]:
    """Return the lines of each layer (coast, border, state, lake), degrees, not thinned."""
    layers: dict[str, list[np.ndarray]] = {name: [] for name in _THINNING}
    arcs = _decoded_arcs(world)
    for index, count in _arc_uses(world["objects"]["countries"]["geometries"]).items():
        layers["coast" if count == 1 else "border"].append(arcs[index])
    arcs = _decoded_arcs(states)
    west, east, south, north = _GREAT_LAKES
    for index, count in _arc_uses(states["objects"]["states"]["geometries"]).items():
        line = arcs[index]
        if count > 1:
            layers["state"].append(line)
        elif np.all((line > (west, south)) & (line < (east, north))):
            layers["lake"].append(line)
    return layers


def packed(lines: Iterable[np.ndarray], tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return points in hundredths of a degree (n, 2) int16 and the length of each line."""
    kept = []
    for line in lines:
        whole = np.round(thinned(line, tolerance) * _HUNDREDTHS).astype(np.int16)
        moved = np.concatenate([[True], np.any(np.diff(whole, axis=0) != 0, axis=1)])
        if np.count_nonzero(moved) > 1:
            kept.append(whole[moved])
    return np.concatenate(kept), np.array([len(line) for line in kept], np.int32)


def build(world_file: Path, states_file: Path, target: Path) -> None:
    """Read the two TopoJSON files and write the compact outline."""
    layers = _selected_lines(
        json.loads(world_file.read_text("utf-8")), json.loads(states_file.read_text("utf-8"))
    )
    arrays: dict[str, np.ndarray] = {}
    for name, lines in layers.items():
        points, lengths = packed(lines, _THINNING[name])
        arrays[f"{name}_points"], arrays[f"{name}_lengths"] = points, lengths
    np.savez_compressed(target, allow_pickle=False, **arrays)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    for argument in ("world", "states", "target"):
        parser.add_argument(argument, type=Path)
    given = parser.parse_args()
    build(given.world, given.states, given.target)
