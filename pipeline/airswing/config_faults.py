"""What is wrong with a configuration, in one message that names the nearest known key.

Assumes pydantic's account of the faults; the first is told, unknown keys before others, and the
rest are counted.
"""

from __future__ import annotations

import difflib
import typing
from pathlib import Path

from pydantic import BaseModel, ValidationError

from airswing.errors import ConfigError, shortened


def explained(err: ValidationError, path: Path, model: type[BaseModel]) -> ConfigError:
    """Tell the first fault in one message, with the nearest known key for an unknown one.

    Parameters
    ----------
    err : ValidationError
        What pydantic found.
    path : Path
        The configuration.
    model : type of BaseModel
        What it was held against.
    """
    # A misspelt key is told before the required one that it leaves missing.
    fault = min(err.errors(), key=lambda one: one["type"] != "extra_forbidden")
    place = ".".join(str(part) for part in fault["loc"] if not _alternative(part))
    others = f"; and {err.error_count() - 1} more" if err.error_count() > 1 else ""
    if fault["type"] == "extra_forbidden":
        near = nearest(str(fault["loc"][-1]), _keys_at(model, fault["loc"][:-1]))
        return ConfigError(f"unknown key{near}{others}", file=path, field=place)
    if fault["type"] == "missing":
        return ConfigError(f"required key is missing{others}", file=path, field=place)
    found = None if isinstance(fault["input"], (dict, BaseModel)) else _written(fault["input"])
    return ConfigError(said_of(fault["msg"]) + others, file=path, field=place or None, found=found)


def said_of(message: str) -> str:
    """What a check of ours says, without pydantic's words before it."""
    return message.removeprefix("Value error, ")


def nearest(word: str, known: list[str]) -> str:
    """Words that end a message: the known one nearest to a word, or all that are known."""
    near = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]!r}?"
    return f"; known: {', '.join(known)}" if known else ""


def _written(value: object) -> str:
    return shortened(repr(value) if isinstance(value, str) else value)


def _alternative(part: int | str) -> bool:
    """Tell pydantic's name of one alternative of a type (``int | "auto"``) from a key."""
    return part == "constrained-int" or str(part).startswith("literal[")


def _keys_at(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Keys the model knows at a place of the file."""
    section: type[BaseModel] | None = model
    for key in location:
        field = section.model_fields.get(str(key)) if section is not None else None
        # The name of one of a mapping's entries (a reference's) is no field: its section stays.
        if field is not None:
            section = _section_of(field.annotation)
    return list(section.model_fields) if section is not None else []


def _section_of(annotation: object) -> type[BaseModel] | None:
    """The section a field holds: itself, or None, or a mapping of names to sections."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = (_section_of(one) for one in typing.get_args(annotation))
    return next((one for one in inner if one is not None), None)
