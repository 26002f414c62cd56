"""Evaluation of corrections and references, changes of compasses, errors of the reports."""

from typing import Any

Content = dict[str, Any]
"""Content of a JSON file, or of a part of it, by the keys of docs/formats.md.

The function that makes it documents the keys.
"""
