"""Run every benchmark of this folder, one after the other, and print what each prints.

    python -m benchmarks [--long] [NAME ...]

Without names all of them, at sizes that end in minutes; ``--long`` at the sizes the bars are stated
for. A benchmark whose bar is missed is named at the end, and the exit status is 1.
"""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

SHORT = {
    "collocation": ["--hours", "24", "--repeats", "3"],
    "fault_drill": ["--kills", "6", "--days", "40", "--aircraft", "3"],
    "year": ["--share", "0.05"],
    "coverage": ["--fleets", "40"],
    "fleet": ["--aircraft", "150", "300", "600"],
    "monitoring": ["--years", "100", "--fleets", "2"],
}
LONG = {"fleet": ["--aircraft", "600", "1200", "2400", "6000"]}
"""Arguments by benchmark; none are given where it has no entry."""
COMPARISONS = {"compare_products", "gap_paired"}
"""Scripts that compare two results, which are their arguments."""


def names():
    stems = {path.stem for path in Path(__file__).parent.glob("[a-z]*.py")}
    return [*SHORT, *sorted(stems - set(SHORT) - COMPARISONS)]


def main():
    """Run the asked benchmarks; 1 where one of them failed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(names())}")
    parser.add_argument("--long", action="store_true", help="at the sizes the bars are stated for")
    options = parser.parse_args()
    sizes = LONG if options.long else SHORT
    unknown = [name for name in options.names if name not in names()]
    if unknown:
        parser.error(f"no benchmark {unknown[0]!r}; known: {', '.join(names())}")
    missed = []
    for name in options.names or names():
        command = [sys.executable, "-m", f"benchmarks.{name}", *sizes.get(name, [])]
        print(f"\n== {' '.join(['python', *command[1:]])}", flush=True)
        began = time.perf_counter()
        done = subprocess.run(command, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=False)
        print(f"-- {name}: {time.perf_counter() - began:.0f} s", flush=True)
        if done.returncode:
            missed.append(name)
    print(f"\nmissed or failed: {', '.join(missed)}" if missed else "\nevery bar held")
    return bool(missed)


if __name__ == "__main__":
    raise SystemExit(main())
