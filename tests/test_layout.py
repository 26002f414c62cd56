"""The rooms of the package: imports run one way, names are told apart, folders are small."""

import ast
from collections import Counter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "pipeline" / "airswing"
ENTRANCES = {"__init__", "__main__", "cli", "cli_options"}

#: Every room may import from those before it. Left of all: the files of the package's own folder.
ORDER = (
    ".",
    "physics",
    "products",
    "reference/packing",
    "synthetic/world",
    "synthetic/aircraft",
    "synthetic/sample",
    "synthetic/sealed",
    "reports/canonical",
    "reports/formats",
    "reports",
    "reference/geometry",
    "reference/grib",
    "reference/gridded/cf",
    "reference/gridded/formats",
    "reference/gridded",
    "reference",
    "compass/fleet",
    "compass/fit",
    "compass/kept_sums",
    "compass",
    "evaluation",
    "evaluation/report_errors",
    "evaluation/backtest",
    "evaluation/reference_comparison",
    "evaluation/compass_changes",
    "evaluation/monitoring",
    "gap/result/schema",
    "gap/noise",
    "gap/archive",
    "gap/effects",
    "gap/simulation",
    "gap/design",
    "gap/sums",
    "gap/evidence",
    "gap/held_out",
    "gap/search",
    "gap/scatter",
    "gap/closure",
    "gap/checks",
    "gap/witness",
    "gap/taken_off",
    "gap/as_sent",
    "gap/result",
    "gap",
    "handover/records",
    "handover/forecasts",
    "handover",
    "report/html",
    "report/forecasts",
    "report/run",
    "report/forecasts",
    "report/gap",
    "workflow",
    "workflow/forecasts",
    "workflow/update",
    "blind_check",
)
#: Folders whose ``__init__`` only hands on what stands in their rooms.
DOORS = {"synthetic", "report"}


def room_of(path: Path) -> str:
    return path.parent.relative_to(PACKAGE).as_posix()


MODULES = {
    ".".join(("airswing", *path.relative_to(PACKAGE).with_suffix("").parts)): path
    for path in sorted(PACKAGE.rglob("*.py"))
}


def file_of(name: str) -> Path | None:
    return MODULES.get(name) or MODULES.get(f"{name}.__init__")


def imported(path: Path) -> set[Path]:
    """Files of the package that a file imports, wherever in it the import stands."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if file_of(name) else str(node.module) for name in names]
        else:
            continue
        found |= {file for name in names if (file := file_of(name))}
    return found - {path}


def inner_files() -> list[Path]:
    doors = {PACKAGE / door / "__init__.py" for door in DOORS}
    entrances = {PACKAGE / f"{name}.py" for name in ENTRANCES}
    return [path for path in MODULES.values() if path not in doors | entrances]


def test_every_room_has_its_place():
    rooms = {room_of(path) for path in inner_files()}
    assert rooms <= set(ORDER), "a new room takes its place in ORDER"


@pytest.mark.parametrize("path", inner_files(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_no_import_runs_back_up(path: Path):
    place = ORDER.index(room_of(path))
    package = PACKAGE / "__init__.py"  # for the version alone
    back = [
        str(other.relative_to(PACKAGE))
        for other in imported(path) - {package}
        if room_of(other) in DOORS or ORDER.index(room_of(other)) > place
    ]
    assert not back


def test_no_circle_of_files():
    arrows = {path: imported(path) for path in MODULES.values()}
    arrows = {path: {one for one in to if one.stem != "__init__"} for path, to in arrows.items()}
    while free := {path for path, to in arrows.items() if not to}:
        arrows = {path: to - free for path, to in arrows.items() if path not in free}
    assert not arrows


def test_folders_are_small():
    counts = Counter(room_of(path) for path in MODULES.values() if path.stem != "__init__")
    counts.pop("gap/effects")  # one file an effect
    assert {room: count for room, count in counts.items() if count > 15} == {}


def test_no_two_files_of_one_name():
    counts = Counter(path.stem for path in MODULES.values() if path.stem != "__init__")
    assert [name for name, count in counts.items() if count > 1] == []


def functions(path: Path) -> list[ast.FunctionDef]:
    return [node for node in ast.walk(ast.parse(path.read_text())) if type(node) is ast.FunctionDef]


def body_lines(function: ast.FunctionDef) -> int:
    """Lines from the first statement after the docstring to the last."""
    body = function.body[ast.get_docstring(function) is not None :]
    return int(body[-1].end_lineno) - body[0].lineno + 1 if body else 0


def parameters(function: ast.FunctionDef) -> int:
    named = [*function.args.posonlyargs, *function.args.args, *function.args.kwonlyargs]
    return sum(one.arg not in ("self", "cls") for one in named)


def test_functions_are_short_and_take_few_arguments():
    """Of commands each option is a parameter: those of many stand in a class (`cli_options`)."""
    found = {
        f"{path.relative_to(PACKAGE)}:{one.name}": (body_lines(one), parameters(one))
        for path in MODULES.values()
        for one in functions(path)
    }
    assert {name: size for name, size in found.items() if size[0] > 60 or size[1] > 8} == {}


def test_a_check_that_sees_an_arrow_back():
    """The test's own eyes: the reports' room is imported by the compass, never the other way."""
    compass = PACKAGE / "compass" / "reported_motion.py"
    assert PACKAGE / "reports" / "resolution.py" in imported(compass)
    assert ORDER.index("reports") < ORDER.index("compass")
