"""What ``airswing gap-check`` does: check, report, and say what was reached.

Assumes nothing but a folder to write to.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    from airswing.blind_check.check_run import Plan
    from airswing.blind_check.check_summary import TargetReached

__all__ = ["check_and_report"]


class Summary(TypedDict):
    """What a check came to: all of it that ``--json`` prints."""

    digest: str
    targets: list[TargetReached]
    every_rung: list[TargetReached]
    proof: dict[str, float]  # the generator's numerical errors, m/s
    settings: dict[str, object]


def check_and_report(
    output: Path,
    plan: Plan,
    *,
    workers: int = 1,
    baselines: bool = True,
    so_far: bool = False,
    quiet: bool = False,
) -> tuple[Summary, str]:
    """Run a blind check and write its table, figure and page.

    Parameters
    ----------
    workers, baselines, so_far
        See `airswing.blind_check.check_run.gap_check`.
    quiet : bool
        Say nothing on the way; the digest is then only in ``sealed.sha256``.

    Returns
    -------
    summary : dict
    text : str
        The same for a terminal.
    """
    from airswing.blind_check.check_report import short_text, write_reports
    from airswing.blind_check.check_run import gap_check
    from airswing.blind_check.check_summary import of_default, targets
    from airswing.blind_check.proof import prove_generator
    from airswing.products.whole_files import require_writable
    from airswing.workflow.progress import Progress

    require_writable(output)
    progress = Progress(quiet=quiet)
    proof = prove_generator(output / "rung_0", seed=plan.seed)
    check = gap_check(
        output, plan, workers=workers, baselines=baselines, so_far=so_far, say=progress.say
    )
    page = write_reports(output, check, command=plan.command, proof=proof)
    summary: Summary = {
        "digest": check.digest,
        "targets": targets(of_default(check.scores)),
        "every_rung": targets(check.scores),
        "proof": proof,
        "settings": check.settings,
    }
    return summary, f"{short_text(check)}\npage: {page}"
