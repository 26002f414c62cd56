"""Sample archives of known aircraft in a known wind: the project's independent truth.

Shares no code with the diagnosis or the compass fit; of the package it uses only the standard
atmosphere and the error classes. Start from `write_archive` or `simulate_arrays`.
"""

from __future__ import annotations

from airswing.synthetic.sample.sample_archive import Scenario, simulate_arrays, write_archive

__all__ = ["Scenario", "simulate_arrays", "write_archive"]
