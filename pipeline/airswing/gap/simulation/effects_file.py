"""``effects.yaml``: which effects a simulation holds; what a diagnosis found, for the next one.

A list, or a mapping with the one key ``effects``, of entries::

    - name: hard_iron
      tails: [N412, N418]        # or all
      parameters: {amplitude_deg: 3.9, phase_deg: 40.1}
      period: null               # or [2009-08-01, null]

Values are numbers in the unit the parameter's name ends with, or text with a unit of the same kind
("2 kt" for m/s). Dates are ISO 8601, UTC. An unknown key, effect, parameter or unit is refused with
the nearest known one.
"""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, date, datetime
from pathlib import Path

import yaml

from airswing.errors import InputError
from airswing.gap.effects import CATALOGUE, ActiveEffect, Effect, Parameter, effect_named
from airswing.gap.effects.base import number
from airswing.products.whole_files import write_text
from airswing.quantities import quantity
from airswing.yaml_file import load_yaml

KEYS = ("name", "tails", "parameters", "period")
_HEADER = "# Effects of a simulation: airswing simulate CONFIG --effects THIS -o FILE\n"


def read_effects(path: Path | str) -> list[ActiveEffect]:
    """Read the effects of a file.

    Parameters
    ----------
    path : path-like
        YAML.

    Returns
    -------
    list of ActiveEffect
        Parameters as numbers in the catalogue's units.

    Raises
    ------
    InputError
        The file is not there, is no YAML, or names something unknown.
    """
    path = Path(path)
    return parse_effects(load_yaml(path), file=path)


def parse_effects(content: object, *, file: object | None = None) -> list[ActiveEffect]:
    """Check effects given as plain lists and mappings.

    Parameters
    ----------
    content : list or mapping or None
        What a YAML or JSON file held; none is no effects.
    file : object, optional
        Named in messages.

    Raises
    ------
    InputError
        Something is unknown or of the wrong kind.
    """
    if isinstance(content, Mapping):
        _only(content, ("effects",), file, "effects file")
        content = content.get("effects")
    if content is None:
        return []
    if not isinstance(content, list):
        raise InputError("effects must be a list", file=file, found=type(content).__name__)
    return [_entry(entry, file) for entry in content]


def write_effects(effects: Iterable[ActiveEffect], path: Path | str) -> Path:
    """Write effects so that `read_effects` gives them back.

    Parameters
    ----------
    path : path-like
        YAML file, written atomically.
    """
    content = plain_effects(effects)
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    return write_text(Path(path), _HEADER + text)


def plain_effects(effects: Iterable[ActiveEffect]) -> list[dict[str, object]]:
    """Give effects as plain lists and mappings, for YAML and JSON.

    Returns
    -------
    list of dict
        Keys ``name, tails, parameters, period``; parameters that are None are left out.
    """
    return [
        {
            "name": active.name,
            "tails": "all" if active.tails is None else [str(tail) for tail in active.tails],
            "parameters": {
                name: _plain(value)
                for name, value in active.parameters.items()
                if value is not None
            },
            "period": plain_period(active.period),
        }
        for active in effects
    ]


def plain_period(period: tuple[float | None, float | None] | None) -> list[str | None] | None:
    """Give a period (s since 1970) as ISO 8601 text, UTC; open ends are None."""
    if period is None:
        return None
    return [None if end is None else _iso(end) for end in period]


def _iso(seconds: float) -> str:
    stamp = datetime.fromtimestamp(seconds, UTC).replace(tzinfo=None)
    # whole seconds, as nearly all are, stay short
    kind = "milliseconds" if stamp.microsecond else "seconds"
    return f"{stamp.isoformat(timespec=kind)}Z"


def _plain(value: object) -> object:
    if isinstance(value, str):
        return value
    return [_plain(part) for part in value] if isinstance(value, Sequence) else number(value)


def _nearest(word: object, known: Iterable[str]) -> str:
    names = list(known)
    # below difflib's own 0.6: what is meant by a short name would be missed, and one guess does no
    # harm
    near = difflib.get_close_matches(str(word), names, n=1, cutoff=0.4)
    return f"Did you mean {near[0]}?" if near else f"Known: {', '.join(names)}"


def _only(
    given: Mapping[object, object], known: Iterable[str], file: object | None, what: str
) -> None:
    names = tuple(known)
    for key in given:
        if key not in names:
            raise InputError(
                f"unknown key in {what}", file=file, found=key, remedy=_nearest(key, names)
            )


def _entry(entry: object, file: object | None) -> ActiveEffect:
    if not isinstance(entry, Mapping):
        raise InputError("every effect must be a mapping", file=file, found=entry)
    _only(entry, KEYS, file, "an effect")
    effect = effect_named(str(entry.get("name")))
    if effect is None:
        raise InputError(
            "unknown effect",
            file=file,
            field="name",
            found=entry.get("name"),
            remedy=_nearest(entry.get("name"), CATALOGUE),
        )
    given = entry.get("parameters") or {}
    if not isinstance(given, Mapping):
        raise InputError("parameters must be a mapping", file=file, field=effect.name, found=given)
    values = _parameters(effect, given, file)
    return ActiveEffect(
        effect.name, values, _tails(entry.get("tails"), file), _period(entry.get("period"), file)
    )


def _parameters(
    effect: Effect, given: Mapping[object, object], file: object | None
) -> dict[str, object]:
    known = {parameter.name: parameter for parameter in effect.parameters}
    for name in given:
        if name not in known:
            raise InputError(
                f"effect {effect.name} has no parameter {name}",
                file=file,
                field=effect.name,
                remedy=_nearest(name, known),
            )
    values = {
        str(name): _number(known[str(name)], value, file)
        for name, value in given.items()
        if value is not None
    }
    try:
        effect.complete(values)
    except InputError as err:
        # the effect knows no file
        raise InputError(err.what, file=file, field=err.field, remedy=err.remedy) from err
    return values


def _number(parameter: Parameter, value: object, file: object | None) -> object:
    if not parameter.number:
        return value
    # a bool is an int to Python
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise InputError("needs a number", file=file, field=parameter.name, found=value)
    if not isinstance(value, str):
        # turned round, for a not-a-number to be refused as well
        if not abs(value) <= sys.float_info.max:
            raise InputError("needs a number", file=file, field=parameter.name, found=value)
        return float(value)
    unit = "dimensionless" if parameter.units == "1" else parameter.units
    try:
        return quantity(value, unit)
    except ValueError as err:
        raise InputError(
            f"needs a number, or a quantity in units of {parameter.units}",
            file=file,
            field=parameter.name,
            found=value,
        ) from err


def _tails(tails: object, file: object | None) -> tuple[str, ...] | None:
    if tails is None or tails == "all":
        return None
    if isinstance(tails, str):
        return (tails,)
    if not isinstance(tails, list) or not tails:
        raise InputError("needs a list of aircraft, or all", file=file, field="tails", found=tails)
    return tuple(str(tail) for tail in tails)


def _period(period: object, file: object | None) -> tuple[float | None, float | None] | None:
    if period is None:
        return None
    if not isinstance(period, list) or len(period) != 2:
        raise InputError("needs [start, end] or null", file=file, field="period", found=period)
    start, end = (_seconds(moment, file) for moment in period)
    if start is not None and end is not None and end <= start:
        raise InputError("ends before it starts", file=file, field="period", found=period)
    return start, end


def _seconds(moment: object, file: object | None) -> float | None:
    if moment is None:
        return None
    try:
        if isinstance(moment, datetime):
            stamp = moment
        elif isinstance(moment, date):
            stamp = datetime(moment.year, moment.month, moment.day)
        else:
            stamp = datetime.fromisoformat(str(moment))
        return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError) as err:
        raise InputError("is no date", file=file, field="period", found=moment) from err
