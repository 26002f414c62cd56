"""The command ``airswing`` in this process, and configurations for it."""

import contextlib
import io
import subprocess

import pytest
import yaml

from airswing import cli


def airswing(*words):
    """Status, output and messages of the command; exceptions other than its exit pass."""
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr("sys.argv", ["airswing", *map(str, words)])
        try:
            cli.main()
        except SystemExit as end:
            status = int(end.code or 0)
    return subprocess.CompletedProcess(words, status, out.getvalue(), err.getvalue())


def configured(folder, reports, references, *, output="out", **sections):
    """Write a configuration in a folder; reports and each reference are files or a section."""
    parts = {"reports": reports, **references}
    parts = {k: v if isinstance(v, dict) else {"files": str(v)} for k, v in parts.items()}
    content = {"reports": parts.pop("reports"), "references": parts}
    path = folder / "config.yaml"
    path.write_text(yaml.safe_dump(content | {"output": str(folder / output)} | sections))
    return path
