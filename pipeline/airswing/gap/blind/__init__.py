"""The blind check: sealed cases from a generator of its own, diagnosed by the public command."""

from airswing.gap.blind.cases import Case, Size, World, plan_cases
from airswing.gap.blind.run import Check, gap_check
from airswing.gap.blind.scoring import score_case
from airswing.gap.blind.sealing import open_seal, seal

__all__ = [
    "Case",
    "Check",
    "Size",
    "World",
    "gap_check",
    "open_seal",
    "plan_cases",
    "score_case",
    "seal",
]
