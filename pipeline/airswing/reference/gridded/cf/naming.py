"""What a configuration says of a Dataset beside what the Dataset says itself."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Naming:
    """Names and meanings that a Dataset's attributes do not tell; all optional.

    Parameters
    ----------
    u, v : str, optional
        Variables of the wind components.
    time, level, latitude, longitude, x, y : str, optional
        Coordinates.
    pressure : str, optional
        Variable of the pressure on native levels.
    surface_pressure : str, optional
        Variable of the surface pressure (or its logarithm) of hybrid levels.
    winds : {"grid", "earth"}, optional
        Whether components point along the grid or to true east and north.
    projection : str or dict, optional
        PROJ or WKT string, or attributes of a CF grid mapping.
    units : dict of str to str
        Units by variable, where a file lacks them or has them wrong.
    """

    u: str | None = None
    v: str | None = None
    time: str | None = None
    level: str | None = None
    latitude: str | None = None
    longitude: str | None = None
    x: str | None = None
    y: str | None = None
    pressure: str | None = None
    surface_pressure: str | None = None
    winds: str | None = None
    projection: str | dict[str, object] | None = None
    units: dict[str, str] = field(default_factory=dict)
