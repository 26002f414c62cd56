"""Share of the page in a run's processor time: the quickstart, and a made archive of ten aircraft.

    python -m benchmarks.page_share [--days N] [--aircraft N]

Each is run once, every stage of ``airswing run`` in this process; what is imported on the way
counts for the stage that needs it first. Exit status 1 where the page takes more than a quarter.
"""

from __future__ import annotations

import argparse
import contextlib
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from airswing import workflow
from airswing.config_file import load_config
from airswing.synthetic.archive import write_archive
from airswing.workflow.progress import Progress, StageRecord

BAR = 0.25


class Timed(Progress):
    """Keeps the processor time of every stage as well, whatever else the machine does."""

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[StageRecord]:
        """Time a stage."""
        began = time.process_time()
        with super().stage(name) as record:
            yield record
        record.phases["stage"] = time.process_time() - began


def main() -> int:
    """Run both and print what each took; 1 where a page is over the bar."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--days", type=int, default=45, help="of the made archive")
    parser.add_argument("--aircraft", type=int, default=10, help="of the made archive")
    given = parser.parse_args()
    over = False
    with tempfile.TemporaryDirectory() as name:
        made = write_archive(Path(name) / "made", days=given.days, aircraft=given.aircraft, seed=1)
        for config in (Path("configs/quickstart.yaml"), made):
            loaded = load_config(config, output=Path(name) / config.stem)
            found = workflow.run_job(workflow.Job(loaded, Timed(quiet=True))).summary
            stages = {s["name"]: s["phases"]["stage"] for s in found["accounts"]["stages"]}
            whole = sum(stages.values())
            over |= stages["page"] > BAR * whole
            print(
                f"{config.stem}: {found['aircraft']} aircraft, {found['reports']['read']:,} "
                f"reports, {whole:.1f} s, page {stages['page']:.1f} s: "
                f"{stages['page'] / whole:.1%} (bar {BAR:.0%})",
                flush=True,
            )
    return int(over)


if __name__ == "__main__":
    raise SystemExit(main())
