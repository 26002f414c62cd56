"""One YAML file, checked in full before anything is read.

Assumes relative paths start at the current directory.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError

from airswing.config import Config, Handover, Postprocess, PostprocessConfig
from airswing.config_faults import explained, said_of
from airswing.errors import ConfigError
from airswing.plain_yaml import load_yaml


def load_config(path: Path | str, *, output: Path | None = None) -> Config:
    """Read and check a configuration.

    Parameters
    ----------
    path : path-like
    output : Path, optional
        Replaces ``output`` of the file.

    Raises
    ------
    ConfigError
        If the file is absent, not YAML, or does not fit.
    """
    return _checked(Config, _content(Path(path), output), Path(path))


def load_postprocess(
    path: Path | str, *, output: Path | None = None
) -> tuple[Postprocess, Path, BaseModel]:
    """Read what ``airswing postprocess`` needs, from a configuration with or without the main job.

    Parameters
    ----------
    path, output
        As for :func:`load_config`.

    Returns
    -------
    Postprocess, Path, BaseModel
        The section, the output folder, and the whole configuration.

    Raises
    ------
    ConfigError
        As :func:`load_config`, and where there is no such section.
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
    found = _checked(model, content, Path(path))
    assert found.postprocess is not None
    return found.postprocess, found.output, found


def _content(path: Path, output: Path | None) -> dict[str, object]:
    """What the file says, with the output folder replaced."""
    if not path.exists():
        raise ConfigError("no such configuration", file=path)
    content = load_yaml(path, ConfigError)
    if not isinstance(content, dict):
        raise ConfigError("a configuration is a mapping of keys to values", file=path)
    if output is not None:
        content["output"] = str(output)
    return content


Model = TypeVar("Model", bound=BaseModel)


def _checked(model: type[Model], content: dict[str, object], path: Path) -> Model:
    """The content as a model has it."""
    try:
        return model.model_validate(content)
    except ValidationError as err:
        raise explained(err, path, model) from err


def with_handover(config: Config, given: Mapping[str, object]) -> Handover:
    """Section ``handover`` with what a command says over it.

    Parameters
    ----------
    config : Config
    given : mapping
        Keys of the section; None is not said.

    Raises
    ------
    ConfigError
        If the two do not go together.
    """
    said = {key: value for key, value in given.items() if value is not None}
    try:
        return Handover.model_validate(config.handover.model_dump() | said)
    except ValidationError as err:
        fault = err.errors()[0]
        key = str(fault["loc"][0]) if fault["loc"] else ""
        place = f"--{key}" if key else "handover"
        raise ConfigError(said_of(fault["msg"]), field=place, found=said.get(key)) from err
