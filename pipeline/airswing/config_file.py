"""Configuration files: YAML that is read, checked completely, and refused with one message.

Relative paths start at the current directory. YAML aliases are refused, because a few lines of
aliases of aliases can expand to a billion values; also tags that construct anything but plain
values, repeated keys, values that contradict their kind (``2009-06-31``), and text that no file
system accepts.
"""

from __future__ import annotations

import contextlib
import re
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import yaml
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from airswing.config import Config, Handover, Postprocess, PostprocessConfig
from airswing.errors import ConfigError, InputError, nearest, shortened

Model = TypeVar("Model", bound=BaseModel)
MOST_BYTES = 1_000_000
# More than any key needs; Python does not even print integers of 4,300 digits.
_MOST_BITS = 256


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
    """Read a section ``postprocess``: it, the output folder, and the whole configuration."""
    content = _content(Path(path), output)
    if content.get("postprocess") is None:
        raise ConfigError(
            "there are no forecasts to correct",
            file=path,
            field="postprocess",
            remedy="Add postprocess with pairs, or with forecasts and stations",
        )
    has_archive = "reports" in content or "references" in content
    model: type[Config | PostprocessConfig] = Config if has_archive else PostprocessConfig
    config = _validated(model, content, Path(path))
    assert config.postprocess is not None
    return config.postprocess, config.output, config


def with_handover(config: Config, overrides: Mapping[str, object]) -> Handover:
    """Return the section ``handover`` with the options of a command that are not None."""
    options = {key: value for key, value in overrides.items() if value is not None}
    try:
        return Handover.model_validate(config.handover.model_dump() | options)
    except ValidationError as err:
        fault = err.errors()[0]
        key = str(fault["loc"][0]) if fault["loc"] else ""
        place = f"--{key}" if key else "handover"
        message = fault["msg"].removeprefix("Value error, ")
        raise ConfigError(message, field=place, found=options.get(key)) from err


@contextlib.contextmanager
def naming_configuration(path: Path | str | None) -> Iterator[None]:
    """Name the configuration's file in errors that name one of its keys and no file."""
    try:
        yield
    except InputError as err:
        section = (err.field or "").split(".")[0]
        if path is None or err.file is not None or section not in Config.model_fields:
            raise
        raise err.located(file=path) from err.__cause__


def _content(path: Path, output: Path | None) -> dict[str, object]:
    if not path.exists():
        remedy = "Check the path, which starts at the current directory; it names a YAML file"
        raise ConfigError("no such configuration", file=path, remedy=remedy)
    content = load_yaml(path, ConfigError)
    if not isinstance(content, dict):
        remedy = "It has at least the keys reports, references and output"
        raise ConfigError(
            "a configuration is a mapping of keys to values", file=path, remedy=remedy
        )
    if output is not None:
        content["output"] = str(output)
    return content


def _validated(model: type[Model], content: dict[str, object], path: Path) -> Model:
    try:
        return model.model_validate(content)
    except ValidationError as err:
        raise _explained(err, content, path, model) from err


def _explained(
    err: ValidationError, content: object, path: Path, model: type[BaseModel]
) -> ConfigError:
    """The faults that pydantic found in the content of a file, as one message.

    An unknown key is reported before a required key that is missing because of it.
    """
    faults: dict[str, ErrorDetails] = {}  # the first of each key
    for fault in sorted(err.errors(), key=lambda fault: fault["type"] != "extra_forbidden"):
        keys, value = [], content
        for key in fault["loc"]:
            if isinstance(value, dict) and (key in value or fault["type"] == "missing"):
                value = value.get(key)
            elif isinstance(value, list) and isinstance(key, int):
                value = value[key]
            else:  # pydantic adds the name of an alternative (``int | "auto"``)
                continue
            keys.append(str(key))
        faults.setdefault(".".join(keys), fault)

    def message(fault: ErrorDetails) -> str:
        if fault["type"] == "extra_forbidden":
            near = nearest(str(fault["loc"][-1]), _known_keys(model, fault["loc"][:-1]))
            return f"unknown key{near}"
        missing = fault["type"] == "missing"
        return "required key is missing" if missing else fault["msg"].removeprefix("Value error, ")

    (place, first), *remaining = faults.items()
    text = message(first) + "".join(f"; {key}: {message(fault)}" for key, fault in remaining)
    value = first["input"]
    shown = None
    if first["type"] not in ("extra_forbidden", "missing") and not isinstance(
        value, dict | BaseModel
    ):
        shown = shortened(repr(value) if isinstance(value, str) else value)
    return ConfigError(text, file=path, field=place or None, found=shown)


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
    inner = (_section_of(section) for section in typing.get_args(annotation))
    return next((section for section in inner if section is not None), None)


def load_yaml(path: Path, kind: type[InputError] = InputError) -> object:
    """Read a YAML file; raise an error of the class `kind` if it is not plain YAML."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as err:
        remedy = "Save it as UTF-8"
        raise kind("not a YAML file: not UTF-8 text", file=path, remedy=remedy) from err
    except OSError as err:
        remedy = "Check its path and permissions"
        raise kind("cannot read the file", file=path, found=err.strerror, remedy=remedy) from err
    if len(content) > MOST_BYTES:
        raise kind(f"larger than {MOST_BYTES:,} bytes: not a file that airswing reads", file=path)
    try:
        return _Loader(text).get_single_data()
    except RecursionError as err:
        raise kind("not a YAML file: nested too deeply", file=path) from err
    except yaml.YAMLError as err:
        problem = " ".join(str(err).split())
        raise kind("not a YAML file that airswing can read", file=path, found=problem) from err


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader without aliases, repeated keys and unusable values."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()  # type: ignore[no-untyped-call]
            raise _fault(f"aliases such as *{event.anchor} are not supported", event)
        return super().compose_node(parent, index)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> object:
        try:
            value = super().construct_object(node, deep=deep)
        except (ValueError, ArithmeticError, TypeError, AttributeError, LookupError) as err:
            written = shortened(getattr(node, "value", ""), 80)
            raise _fault(f"{written!r} is not a valid {node.tag.rpartition(':')[2]}", node) from err
        # lone surrogates cannot be encoded
        if isinstance(value, str) and re.search("[\0\ud800-\udfff]", value):
            raise _fault("text that cannot be used", node)
        if isinstance(value, int) and value.bit_length() > _MOST_BITS:
            raise _fault("an integer that is too large", node)
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, object]:
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, str | int | float):
                if key in seen:
                    raise _fault(f"the key {shortened(key, 60)!r} is given twice", key_node)
                seen.add(key)
        return super().construct_mapping(node, deep=deep)


def _fault(text: str, node: Any) -> yaml.YAMLError:
    return yaml.YAMLError(f"line {node.start_mark.line + 1}: {text}")
