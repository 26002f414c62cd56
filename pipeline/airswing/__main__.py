"""``python -m airswing`` is the ``airswing`` command."""

from airswing.cli import main

main()
