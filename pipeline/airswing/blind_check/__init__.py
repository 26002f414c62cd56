"""Blind check of the gap diagnosis: sealed archives, diagnosed by the public command, then scored.

``check`` plans the cases, seals their labels, and runs the diagnosis; ``score`` compares each
``gap.json`` with its label; ``summary`` computes the figures and writes the report.
"""

from airswing.blind_check.check import Check, Plan, gap_check
from airswing.blind_check.score import score_case
from airswing.blind_check.summary import targets, write_report

__all__ = ["Check", "Plan", "gap_check", "score_case", "targets", "write_report"]
