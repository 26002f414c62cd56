"""Imports inside the package follow the data: a folder imports only from the folders before it."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[1] / "pipeline" / "airswing"
#: Modules of the package's top level that users enter by; they may import from everywhere.
ENTRANCES = {"__init__", "__main__", "cli"}

#: Every folder may import from those before it. First: the modules of the package's top level.
ORDER = (
    *(".", "physics", "products", "synthetic", "reports", "reference", "compass", "evaluation"),
    *("gap", "handover", "report", "workflow", "blind_check"),
)
MODULES = {
    ".".join(("airswing", *path.relative_to(PACKAGE).with_suffix("").parts)): path
    for path in sorted(PACKAGE.rglob("*.py"))
}
INNER = [
    path
    for path in MODULES.values()
    if not (path.parent == PACKAGE and path.stem in ENTRANCES)
    and path.name != "__init__.py"  # passes on what its modules define
]


def folder_of(path):
    parts = path.relative_to(PACKAGE).parts
    return parts[0] if len(parts) > 1 else "."


def imported(path):
    """Modules of the package that a module imports, wherever the import statement is."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names] + [str(node.module)]
        else:
            continue
        modules |= {MODULES[name] for name in names if name in MODULES}
    return modules - {path}


@pytest.mark.parametrize("path", INNER, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_come_from_the_same_folder_or_an_earlier_one(path):
    place = ORDER.index(folder_of(path))
    later = [
        str(target.relative_to(PACKAGE))
        for target in imported(path)
        if ORDER.index(folder_of(target)) > place
    ]
    assert not later


def test_no_modules_import_each_other_in_a_circle():
    arrows = {path: imported(path) & set(INNER) for path in INNER}
    while free := {path for path, to in arrows.items() if not to}:
        arrows = {path: to - free for path, to in arrows.items() if path not in free}
    assert not arrows
