"""Configuration files: read, checked completely, and refused with one message.

Assumes that relative paths start at the current directory.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from airswing.config import Config, Handover, Postprocess, PostprocessConfig
from airswing.errors import ConfigError, shortened
from airswing.yaml_file import load_yaml, nearest

Model = TypeVar("Model", bound=BaseModel)


def load_config(path: Path | str, *, output: Path | None = None) -> Config:
    """Read and check a configuration.

    Parameters
    ----------
    path : path-like
        The YAML file.
    output : Path, optional
        Output folder in place of the file's ``output``.

    Returns
    -------
    Config

    Raises
    ------
    ConfigError
        If the file is absent, is not YAML, or contains an invalid value or an unknown key.

    Examples
    --------
    >>> config = airswing.load_config("configs/quickstart.yaml")
    >>> config.fit.min_reports
    200
    """
    return _validated(Config, _content(Path(path), output), Path(path))


def load_postprocess(
    path: Path | str, *, output: Path | None = None
) -> tuple[Postprocess, Path, BaseModel]:
    """Read a configuration with the section ``postprocess``, with or without the main job.

    Returns
    -------
    Postprocess, Path, BaseModel
        The section, the output folder, and the whole configuration.
    """
    content = _content(Path(path), output)
    if content.get("postprocess") is None:
        raise ConfigError(
            "there are no forecasts to correct",
            file=path,
            field="postprocess",
            remedy="Add postprocess with pairs, or with forecasts and stations",
        )
    whole = "reports" in content or "references" in content
    model: type[Config | PostprocessConfig] = Config if whole else PostprocessConfig
    found = _validated(model, content, Path(path))
    assert found.postprocess is not None
    return found.postprocess, found.output, found


def with_handover(config: Config, given: Mapping[str, object]) -> Handover:
    """Return the section ``handover`` with the options of a command that are not None."""
    options = {key: value for key, value in given.items() if value is not None}
    try:
        return Handover.model_validate(config.handover.model_dump() | options)
    except ValidationError as err:
        fault = err.errors()[0]
        key = str(fault["loc"][0]) if fault["loc"] else ""
        place = f"--{key}" if key else "handover"
        message = fault["msg"].removeprefix("Value error, ")
        raise ConfigError(message, field=place, found=options.get(key)) from err


def _content(path: Path, output: Path | None) -> dict[str, object]:
    if not path.exists():
        raise ConfigError("no such configuration", file=path)
    content = load_yaml(path, ConfigError)
    if not isinstance(content, dict):
        raise ConfigError("a configuration is a mapping of keys to values", file=path)
    if output is not None:
        content["output"] = str(output)
    return content


def _validated(model: type[Model], content: dict[str, object], path: Path) -> Model:
    try:
        return model.model_validate(content)
    except ValidationError as err:
        raise _explained(err, path, model) from err


def _explained(err: ValidationError, path: Path, model: type[BaseModel]) -> ConfigError:
    """The faults that pydantic found, as one message.

    An unknown key is reported before a required key that is missing because of it.
    """
    faults: dict[str, ErrorDetails] = {}  # the first of each key
    for fault in sorted(err.errors(), key=lambda one: one["type"] != "extra_forbidden"):
        # Pydantic adds the name of an alternative (``int | "auto"``) to the location.
        keys = [str(part) for part in fault["loc"] if part != "constrained-int"]
        faults.setdefault(".".join(k for k in keys if not k.startswith("literal[")), fault)

    def message(fault: ErrorDetails) -> str:
        if fault["type"] == "extra_forbidden":
            near = nearest(str(fault["loc"][-1]), _known_keys(model, fault["loc"][:-1]))
            return f"unknown key{near}"
        missing = fault["type"] == "missing"
        return "required key is missing" if missing else fault["msg"].removeprefix("Value error, ")

    (place, first), *others = faults.items()
    what = message(first) + "".join(f"; {key}: {message(one)}" for key, one in others)
    value = first["input"]
    found = None
    if first["type"] not in ("extra_forbidden", "missing") and not isinstance(
        value, dict | BaseModel
    ):
        found = shortened(repr(value) if isinstance(value, str) else value)
    return ConfigError(what, file=path, field=place or None, found=found)


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    section: type[BaseModel] | None = model
    for key in location:
        field = section.model_fields.get(str(key)) if section is not None else None
        # The name of an entry of a mapping (of a reference) is not a field: the section remains.
        if field is not None:
            section = _section_of(field.annotation)
    return list(section.model_fields) if section is not None else []


def _section_of(annotation: object) -> type[BaseModel] | None:
    """The section in a field's type: itself, or optional, or the values of a mapping."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    inner = (_section_of(one) for one in typing.get_args(annotation))
    return next((one for one in inner if one is not None), None)
