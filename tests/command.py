"""The command ``airswing`` in this process."""

import contextlib
import io
import subprocess

import pytest

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
