"""Digests of code: what a module uses counts, what it does not use does not."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from airswing.products.fingerprint import code_digest, file_identities, fingerprint


def package(folder: Path, **sources: str) -> Path:
    top = folder / "thing"
    (top / "part").mkdir(parents=True)
    for name, text in sources.items():
        (top / name.replace("__", "/")).with_suffix(".py").write_text(text)
    return top


USES = {
    "part__stage": "from thing.part import (\n    kernel as k,\n)\n",
    "part__kernel": "def f():\n    import thing.table\n",
    "table": "A = 1\n",
    "other": "B = 1\n",
}


@pytest.mark.parametrize(
    ("changed", "counts"),
    [("part__stage", True), ("part__kernel", True), ("table", True), ("other", False)],
)
def test_only_what_a_module_uses_counts(tmp_path, changed, counts):
    first = code_digest("thing.part.stage", package=package(tmp_path / "a", **USES))
    sources = USES | {changed: USES[changed] + "# changed\n"}
    second = code_digest("thing.part.stage", package=package(tmp_path / "b", **sources))
    assert (first != second) is counts


def test_every_import_of_the_package_is_seen_as_python_sees_it():
    from airswing.products.fingerprint import PACKAGE, _imported, _source

    for path in PACKAGE.rglob("*.py"):
        used = set()
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                used |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                used |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        ours = {_source(name, PACKAGE) for name in used if name.split(".")[0] == "airswing"}
        seen = {_source(name, PACKAGE) for name in _imported(path, "airswing")}
        assert seen | {None} == ours | {None}, path


def test_a_file_counts_by_size_and_time(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("one")
    before = fingerprint(file_identities([str(path)]))
    assert fingerprint(file_identities([str(path)])) == before
    path.write_text("longer")
    assert fingerprint(file_identities([str(path)])) != before
