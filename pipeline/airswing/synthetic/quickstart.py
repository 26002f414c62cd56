"""The small archive of ``data_samples/``: six aircraft, five weeks, and eight days of field test.

``python -m airswing.synthetic.quickstart data_samples`` reproduces the files. Reports before 20
October 2009 go to ``reports/``; later ones, where two aircraft apply their tables, to
``field_test/``.
"""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path

from airswing.synthetic.archive import write_archive

SEED = 2012
DAYS_BEFORE, DAYS_AFTER = 34, 8
"""Days for the fit of six curves, and of the test."""
CORRECTED = ("N401", "N404")
# Offset, amplitude and phase (degrees) and airspeed scale (per cent) of each unit.
_UNITS = {
    "N401": (0.8, 5.8, 35.0, 0.4),
    "N402": (-1.2, 1.4, -110.0, -0.3),
    "N403": (0.5, 2.6, 160.0, 0.1),
    "N404": (-0.6, 4.2, -50.0, -0.2),
    "N405": (0.3, 0.8, 80.0, 0.3),
    "N406": (1.0, 3.0, 10.0, 0.0),
}


def _effects() -> list[dict[str, object]]:
    effects: list[dict[str, object]] = []
    for tail, (offset, amplitude, phase, scale) in _UNITS.items():
        sizes: dict[str, dict[str, float]] = {
            "compass_offset": {"offset_deg": offset},
            "hard_iron": {"amplitude_deg": amplitude, "phase_deg": phase},
            "tas_scale": {"scale_percent": scale},
        }
        if tail == "N403":
            sizes["soft_iron"] = {"amplitude_deg": 1.6, "phase_deg": 60.0}
        effects += [{"name": n, "tails": [tail], "parameters": size} for n, size in sizes.items()]
    return effects


EFFECTS = _effects()
"""Faults of the six units."""


def write_quickstart(directory: str | Path) -> Path:
    """Write ``reports/``, ``field_test/``, ``ruc/``, ``rtfdaa/`` and ``truth/``; the folder."""
    root = Path(directory)
    config = write_archive(
        root,
        days=DAYS_BEFORE + DAYS_AFTER,
        aircraft=6,
        seed=SEED,
        effects=EFFECTS,
        start=datetime(2009, 9, 16),
        network="lower_lakes",
        columns=20,
        rows=18,
        spacing_km=50.0,
        levels=(950, 850, 750, 650, 550, 450, 350),
        interval_hours=3,
        lead_hours=3,
        times_per_file=8,
        legs_per_day=6.0,
        climb_seconds=240.0,
        cruise_seconds=80.0,
        field_test=(DAYS_BEFORE, CORRECTED),
        thinned={"N406": 0.025},
    )
    config.unlink()
    later = root / "field_test"
    later.mkdir(exist_ok=True)
    for path in sorted((root / "reports").glob("*.csv")):
        header, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
        during = [row for row in rows if row.split(",")[1] >= "2009-10-20"]
        before = [row for row in rows if row.split(",")[1] < "2009-10-20"]
        path.write_text(header + "".join(before), encoding="utf-8")
        if during:
            (later / path.name).write_text(header + "".join(during), encoding="utf-8")
    return root


if __name__ == "__main__":
    write_quickstart(sys.argv[1] if len(sys.argv) > 1 else "data_samples")
