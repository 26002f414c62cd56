"""What a configuration says of a Dataset beside what the Dataset says itself."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Naming:
    """Names and meanings that a Dataset's attributes do not tell; all optional."""

    # u, v: variables of the wind components
    u: str | None = None
    v: str | None = None
    # time, level, latitude, longitude, x, y: coordinates
    time: str | None = None
    level: str | None = None
    latitude: str | None = None
    longitude: str | None = None
    x: str | None = None
    y: str | None = None
    pressure: str | None = None  # variable of the pressure on native levels
    # variable of the surface pressure (or its logarithm) of hybrid levels
    surface_pressure: str | None = None
    # {"grid", "earth"}; whether components point along the grid or to true east and north
    winds: str | None = None
    # PROJ or WKT string, or attributes of a CF grid mapping
    projection: str | dict[str, object] | None = None
    # units by variable, where a file lacks them or has them wrong
    units: dict[str, str] = field(default_factory=dict)
