"""Write the sample's fields as GRIB1 and GRIB2, the way operational files come.

Assumptions: one wind component on one isobaric level a message, Lambert conformal, rows from the
south-west corner (i along x, j northward), instantaneous forecasts. GRIB1 is RUC-like (NCEP,
simple packing); GRIB2 is RTFDAA-like (shape of the earth 6, simple packing or complex packing
with spatial differencing). Levels are whole hPa.

Validity: checked by reading back with eccodes and cfgrib in the tests. Units: m/s, hPa, hours.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import eccodes
import numpy as np
from numpy.typing import NDArray

from airswing.synthetic.world.gridded_fields import GriddedReference
from airswing.synthetic.world.lambert import LambertGrid

__all__ = ["MessageWriter", "write_reference"]

# Decimals of m/s kept, as the fields themselves are rounded to.
_DECIMALS = 1
# Packings that take a number of bits, not of decimals: steps of 0.03-0.1 m/s for winds.
_FIXED_BITS = {"grid_complex_spatial_differencing": 10, "grid_complex": 10, "grid_ccsds": 10}


def _grid_keys(grid: LambertGrid, edition: int) -> dict[str, float | int | str]:
    """Return the keys of the grid section."""
    keys: dict[str, float | int | str] = {
        "gridType": "lambert",
        "Nx": grid.columns,
        "Ny": grid.rows,
        "latitudeOfFirstGridPointInDegrees": grid.first_latitude,
        "longitudeOfFirstGridPointInDegrees": grid.first_longitude % 360.0,
        "LoVInDegrees": grid.orientation % 360.0,
        "DxInMetres": int(grid.spacing),
        "DyInMetres": int(grid.spacing),
        "Latin1InDegrees": grid.standard_parallel,
        "Latin2InDegrees": grid.standard_parallel,
        "latitudeOfSouthernPoleInDegrees": -90.0,
        "longitudeOfSouthernPoleInDegrees": 0.0,
        "projectionCentreFlag": 0,
        "iScansNegatively": 0,
        "jScansPositively": 1,
        "jPointsAreConsecutive": 0,
    }
    if edition == 2:
        keys["shapeOfTheEarth"] = 6
        keys["LaDInDegrees"] = grid.standard_parallel
    return keys


def _component_keys(edition: int, component: int) -> dict[str, int]:
    """Return the keys that say which wind component a message holds (0 u, 1 v)."""
    if edition == 1:
        return {"table2Version": 2, "indicatorOfParameter": 33 + component}
    return {"discipline": 0, "parameterCategory": 2, "parameterNumber": 2 + component}


class MessageWriter:
    """Writes messages of one grid from a prepared template.

    Parameters
    ----------
    grid : LambertGrid
        Grid of every message.
    edition : int
        1 or 2.
    grid_relative : bool
        Whether the flag says components lie along the grid.
    packing : str
        ``grid_simple``, ``grid_complex_spatial_differencing``, ``grid_jpeg``, ``grid_ccsds``.
    """

    def __init__(
        self,
        grid: LambertGrid,
        *,
        edition: int,
        grid_relative: bool,
        packing: str = "grid_simple",
    ) -> None:
        self._edition = edition
        self._templates = []
        for component in (0, 1):
            handle = eccodes.codes_grib_new_from_samples(f"GRIB{edition}")
            eccodes.codes_set(handle, "centre", 7)  # NCEP, as the real files
            if edition == 1:
                eccodes.codes_set(handle, "generatingProcessIdentifier", 105)
            for key, value in _grid_keys(grid, edition).items():
                eccodes.codes_set(handle, key, value)
            eccodes.codes_set(handle, "uvRelativeToGrid", int(grid_relative))
            eccodes.codes_set(handle, "typeOfLevel", "isobaricInhPa")
            for key, value in _component_keys(edition, component).items():
                eccodes.codes_set(handle, key, value)
            if packing not in _FIXED_BITS:
                eccodes.codes_set(handle, "bitsPerValue", 0)
                eccodes.codes_set(handle, "decimalPrecision", _DECIMALS)
            if packing != "grid_simple":
                eccodes.codes_set_values(handle, np.arange(grid.rows * grid.columns, dtype=float))
                eccodes.codes_set(handle, "packingType", packing)
            self._templates.append(handle)
        self._bits = _FIXED_BITS.get(packing)

    def message(
        self,
        values: NDArray[np.float32],
        *,
        component: int,
        level: float,
        base: datetime,
        lead: int,
    ) -> bytes:
        """Return one message.

        Parameters
        ----------
        values : ndarray (rows, columns)
            m/s.
        component : int
            0 for u, 1 for v.
        level : float
            hPa.
        base : datetime
            Start of the forecast, UTC.
        lead : int
            Hours.

        Returns
        -------
        bytes
            The encoded message.
        """
        handle = self._templates[component]
        eccodes.codes_set(handle, "dataDate", base.year * 10000 + base.month * 100 + base.day)
        eccodes.codes_set(handle, "dataTime", base.hour * 100 + base.minute)
        eccodes.codes_set(handle, "endStep", lead)
        eccodes.codes_set(handle, "level", int(level))
        if self._bits is None:
            eccodes.codes_set(handle, "decimalPrecision", _DECIMALS)
        else:  # encoding lowers the bits of the handle it leaves behind
            eccodes.codes_set(handle, "bitsPerValue", self._bits)
        eccodes.codes_set_values(handle, values.astype(np.float64).ravel())
        return bytes(eccodes.codes_get_message(handle))

    def close(self) -> None:
        """Give the templates back."""
        for handle in self._templates:
            eccodes.codes_release(handle)


def write_reference(
    directory: Path,
    stored: GriddedReference,
    *,
    start: datetime,
    edition: int,
    lead_hours: int,
    packing: str = "grid_simple",
    times_per_file: int = 1,
) -> list[Path]:
    """Write the fields of one reference.

    Parameters
    ----------
    directory : Path
        Folder, made where missing.
    start : datetime
        Hour zero, UTC.
    edition : int
        1 or 2.
    lead_hours : int
        Every field is a forecast of this length.
    packing : str
        eccodes' packing type.
    times_per_file : int
        Valid times in one file.

    Returns
    -------
    list of Path
        Files, in order of time.
    """
    directory.mkdir(parents=True, exist_ok=True)
    suffix = {1: "grb", 2: "grb2"}[edition]
    writer = MessageWriter(
        stored.grid,
        edition=edition,
        grid_relative=stored.grid_relative,
        packing=packing,
    )
    files = []
    try:
        for first in range(0, stored.hours.size, times_per_file):
            group = range(first, min(first + times_per_file, stored.hours.size))
            base = start + timedelta(hours=float(stored.hours[first]) - lead_hours)
            path = directory / f"{stored.name}_{base:%Y%m%d%H}_f{lead_hours:02d}.{suffix}"
            with path.open("wb") as sink:
                for step in group:
                    when = start + timedelta(hours=float(stored.hours[step]) - lead_hours)
                    for index, level in enumerate(stored.levels):
                        for component in (0, 1):
                            sink.write(
                                writer.message(
                                    stored.wind[step, component, index],
                                    component=component,
                                    level=float(level),
                                    base=when,
                                    lead=lead_hours,
                                )
                            )
            files.append(path)
    finally:
        writer.close()
    return files
