"""The blind check: sealed cases from a generator of its own, diagnosed by the public command."""

from airswing.blind_check.check_run import Check, Plan, gap_check
from airswing.blind_check.scoring import score_case
from airswing.synthetic.sealed.cases import Case, Size, World, plan_cases
from airswing.synthetic.sealed.sealing import open_seal, seal

__all__ = [
    "Case",
    "Check",
    "Plan",
    "Size",
    "World",
    "gap_check",
    "open_seal",
    "plan_cases",
    "score_case",
    "seal",
]
