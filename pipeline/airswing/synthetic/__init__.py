"""Sample archives of known aircraft in a known wind: the truth that results are compared with.

Shares no code with the diagnosis or the compass fit; of the package it uses the standard
atmosphere, units and error classes. Start from `write_archive` or `simulate_arrays`.
"""

from __future__ import annotations

from airswing.synthetic.archive import Scenario, simulate_arrays, write_archive

__all__ = ["Scenario", "simulate_arrays", "write_archive"]
