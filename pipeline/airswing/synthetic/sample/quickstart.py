"""The small archive of ``data_samples/``: six aircraft, five weeks, and eight days of field test.

Assumptions: a coarse grid over the lower Great Lakes, three-hourly fields on seven levels, all
below 8 MB. Run as ``python -m airswing.synthetic.sample.quickstart data_samples``; the seed is
fixed, so the files come out the same. Reports before 20 October 2009 go to ``reports/``; later
ones, where two aircraft already apply their tables, to ``field_test/``.

Units: those of the canonical columns.
"""

from __future__ import annotations

import sys
from datetime import datetime
from pathlib import Path

from airswing.synthetic.sample.sample_archive import write_archive

__all__ = ["EFFECTS", "write_quickstart"]

# The committed files have it.
_SEED = 2012
# Five weeks to learn six curves from; the test is the last eight days.
DAYS_BEFORE, DAYS_AFTER = 34, 8
CORRECTED = ("N401", "N404")


def _compass(
    tail: str, offset: float, amplitude: float, phase: float, scale: float
) -> list[dict[str, object]]:
    """Return the ordinary faults of one unit."""
    sizes: dict[str, dict[str, float]] = {
        "compass_offset": {"offset_deg": offset},
        "hard_iron": {"amplitude_deg": amplitude, "phase_deg": phase},
        "tas_scale": {"scale_percent": scale},
    }
    return [{"name": name, "tails": [tail], "parameters": sizes[name]} for name in sizes]


# What is wrong with the six units.
EFFECTS: list[dict[str, object]] = [
    *_compass("N401", 0.8, 5.8, 35.0, 0.4),
    *_compass("N402", -1.2, 1.4, -110.0, -0.3),
    *_compass("N403", 0.5, 2.6, 160.0, 0.1),
    {
        "name": "soft_iron",
        "tails": ["N403"],
        "parameters": {"amplitude_deg": 1.6, "phase_deg": 60.0},
    },
    *_compass("N404", -0.6, 4.2, -50.0, -0.2),
    *_compass("N405", 0.3, 0.8, 80.0, 0.3),
    *_compass("N406", 1.0, 3.0, 10.0, 0.0),
]


def _split(directory: Path, boundary: str) -> None:
    """Move rows from ``boundary`` (ISO 8601) on from reports/ to field_test/."""
    later = directory / "field_test"
    later.mkdir(exist_ok=True)
    for path in sorted((directory / "reports").glob("*.csv")):
        header, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True)
        parts = {
            path: [row for row in rows if row.split(",")[1] < boundary],
            later / path.name: [row for row in rows if row.split(",")[1] >= boundary],
        }
        for target, kept in parts.items():
            if kept or target == path:
                target.write_text(header + "".join(kept), encoding="utf-8")


def write_quickstart(directory: str | Path) -> Path:
    """Write the sample archive.

    Parameters
    ----------
    directory : path
        Folder for ``reports/``, ``field_test/``, ``ruc/``, ``rtfdaa/``, ``truth/``.
    """
    root = Path(directory)
    start = datetime(2009, 9, 16)
    config = write_archive(
        root,
        days=DAYS_BEFORE + DAYS_AFTER,
        aircraft=6,
        seed=_SEED,
        effects=EFFECTS,
        start=start,
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
    _split(root, "2009-10-20")
    return root


if __name__ == "__main__":
    write_quickstart(sys.argv[1] if len(sys.argv) > 1 else "data_samples")
