"""The process that runs cases one after the other, within limits of memory; it may die of one.

    python -m benchmarks.fuzz.worker SEEDS.json

Reads ``kind<TAB>seed<TAB>folder`` a line and answers with a line of JSON.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import traceback
from pathlib import Path

from benchmarks.fuzz.targets import FoundError, case

MEMORY = 4 << 30


def answer(kind: str, seed: int, seeds: dict[str, Path], folder: Path) -> dict[str, str]:
    """Run one case and say how it ended."""
    try:
        return {"end": case(kind, seed, seeds, folder)}
    except FoundError as found:
        return {"end": found.column, "what": found.what}
    except subprocess.TimeoutExpired:
        return {"end": "hang", "what": "the command did not end"}
    except Exception as error:
        place = traceback.extract_tb(error.__traceback__)
        own = [step for step in place if "/airswing/" in step.filename] or place
        where = f"{Path(own[-1].filename).name}:{own[-1].lineno}"
        return {"end": "traceback", "what": f"{type(error).__name__} at {where}: {error}"[:300]}


def main() -> None:
    """Answer until there are no more cases."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # libraries print there
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    told = json.loads(Path(sys.argv[1]).read_text())
    seeds = {kind: Path(path) for kind, path in told.items()}
    for line in sys.stdin:
        kind, seed, folder = line.rstrip("\n").split("\t")
        print(json.dumps(answer(kind, int(seed), seeds, Path(folder))), file=answers, flush=True)


if __name__ == "__main__":
    main()
