"""Effects of a simulation in ``effects.yaml``, and fitted deviations of ``fits.nc`` as effects.

A list, or a mapping with the one key ``effects``, of entries with name, tails (or ``all``),
parameters and period (null, or two dates, ISO 8601, UTC; see docs/formats.md). Values are numbers
in the unit at the end of the parameter's name, or text with a compatible unit ("2 kt" for m/s).
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import xarray as xr
import yaml

from airswing.config_file import load_yaml
from airswing.errors import InputError, nearest
from airswing.flags import published
from airswing.gap.effects import CATALOGUE, ActiveEffect, Parameter, effect_named
from airswing.gap.effects.base import number
from airswing.gap.effects.empirical import IRREVERSIBLE
from airswing.gap.result.schema import EffectEntry, GapReport, PlaceEntry, UnknownEntry
from airswing.products.whole_files import json_types, write_text
from airswing.quantities import quantity


# ------------------------------------------------------------------------------------- reading
def read_effects(path: Path | str) -> list[ActiveEffect]:
    """Read the effects of a YAML file, with numbers in the units of the catalogue."""
    return parse_effects(load_yaml(Path(path)), file=path)


def read_known(path: Path | str, *, reference: str) -> list[ActiveEffect]:
    """Read known effects from ``effects.yaml``, or the deviations of ``fits.nc`` as effects.

    ``reference`` is the reference or pool of the fits; InputError where the file holds neither.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError("no file of known effects", file=path, remedy="effects.yaml or fits.nc")
    if path.suffix != ".nc":
        return read_effects(path)
    from airswing.products.netcdf import read_product

    fits = read_product(path)
    if "deviation" not in fits or "reference" not in fits.dims:
        raise InputError("holds no fitted deviations", file=path, remedy="give a run's fits.nc")
    return effects_of_fits(fits, reference=reference, file=path)


def effects_of_fits(
    fits: xr.Dataset, *, reference: str, file: Path | None = None
) -> list[ActiveEffect]:
    """Convert the accepted fits of every aircraft against a reference into effects.

    These are offset, hard iron (at the horizontal field of the coefficients), soft iron and
    airspeed scale. InputError where the reference was not fitted, or no fit was accepted.
    """
    names = [str(name) for name in fits["reference"].values]
    if reference not in names:
        raise InputError(
            "no fit against the gap's reference",
            file=file,
            field="reference",
            found=reference,
            remedy=f"fitted were {', '.join(names)}; set gap.reference to one of them",
        )
    fits = fits.isel(reference=names.index(reference))
    out: list[ActiveEffect] = []
    for k, tail in enumerate(str(name) for name in fits["aircraft"].values):
        fit = fits.isel(aircraft=k)
        if not published(fit["status"]) or not np.isfinite(fit["deviation"]).all():
            continue
        # the curve A + B sin + C cos + D sin 2 + E cos 2, degrees
        a, b, c, d, e = (float(value) for value in fit["deviation"].values)
        effects: dict[str, dict[str, object]] = {"compass_offset": {"offset_deg": a}}
        for name, sine, cosine in (("hard_iron", b, c), ("soft_iron", d, e)):
            if sine != 0.0 or cosine != 0.0:
                phase = float(np.degrees(np.arctan2(cosine, sine)))
                effects[name] = {"amplitude_deg": float(np.hypot(sine, cosine)), "phase_deg": phase}
        if "hard_iron" in effects:
            effects["hard_iron"]["at_horizontal_field_nT"] = float(fit["mean_horizontal_field"])
        scale = float(fit["airspeed_scale"])
        if np.isfinite(scale):
            effects["tas_scale"] = {"scale_percent": 100.0 * scale}
        out += [ActiveEffect(name, values, (tail,)) for name, values in effects.items()]
    if not out:
        raise InputError("no accepted fit to start from", file=file, field="status")
    return out


# ------------------------------------------------------------------------------------- writing
def write_effects(effects: Iterable[ActiveEffect], path: Path | str) -> Path:
    """Write effects to a YAML file that `read_effects` reads, atomically."""
    content = plain_effects(effects)
    text = "# Effects of a simulation: airswing simulate CONFIG --effects THIS -o FILE\n"
    text += yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=100)
    return write_text(Path(path), text)


def plain_effects(effects: Iterable[ActiveEffect]) -> list[dict[str, object]]:
    """Convert effects to mappings for YAML and JSON; parameters that are None are left out."""
    return [
        {
            "name": active.name,
            "tails": "all" if active.tails is None else [str(tail) for tail in active.tails],
            "parameters": {k: _builtin(v) for k, v in active.parameters.items() if v is not None},
            "period": plain_period(active.period),
        }
        for active in effects
    ]


def plain_period(period: tuple[float | None, float | None] | None) -> list[str | None] | None:
    """Convert a period (s since 1970) to ISO 8601 text, UTC; open ends are None."""
    if period is None:
        return None
    ends = ["" if end is None else datetime.fromtimestamp(end, UTC).isoformat() for end in period]
    return [end.replace("+00:00", "Z") or None for end in ends]


def _builtin(value: object) -> object:
    if isinstance(value, str):
        return value
    return [_builtin(item) for item in value] if isinstance(value, Sequence) else number(value)


# ------------------------------------------------------------------------------------ checking
def parse_effects(content: object, *, file: object | None = None) -> list[ActiveEffect]:
    """Check effects given as plain lists and mappings; InputError for anything unknown."""
    if isinstance(content, Mapping):
        _check_keys(content, ("effects",), file, "unknown key in effects file")
        content = content.get("effects")
    if content is None:
        return []
    if not isinstance(content, list):
        raise InputError("effects must be a list", file=file, found=type(content).__name__)
    return [_entry(entry, file) for entry in content]


def _entry(entry: object, file: object | None) -> ActiveEffect:
    if not isinstance(entry, Mapping):
        raise InputError("every effect must be a mapping", file=file, found=entry)
    keys = ("name", "tails", "parameters", "period")
    _check_keys(entry, keys, file, "unknown key in an effect")
    name, raw = entry.get("name"), entry.get("parameters") or {}
    effect = effect_named(str(name))
    if effect is None:
        message = f"unknown effect{nearest(str(name), list(CATALOGUE))}"
        raise InputError(message, file=file, field="name", found=name)
    if not isinstance(raw, Mapping):
        raise InputError("parameters must be a mapping", file=file, field=effect.name, found=raw)
    allowed = {parameter.name: parameter for parameter in effect.parameters}
    _check_keys(raw, allowed, file, f"unknown parameter of effect {effect.name}", effect.name)
    used = {str(name): value for name, value in raw.items() if value is not None}
    values = {name: _number(allowed[name], value, file) for name, value in used.items()}
    try:
        effect.complete(values)
    except InputError as err:
        raise InputError(err.what, file=file, field=err.field, remedy=err.remedy) from err
    tails = entry.get("tails")
    if tails == "all":
        tails = None
    elif isinstance(tails, str):
        tails = [tails]
    if tails is not None and (not isinstance(tails, list) or not tails):
        raise InputError("needs a list of aircraft, or all", file=file, field="tails", found=tails)
    names = None if tails is None else tuple(str(tail) for tail in tails)
    return ActiveEffect(effect.name, values, names, _period(entry.get("period"), file))


def _check_keys(
    content: Mapping[object, object],
    allowed: Iterable[str],
    file: object | None,
    message: str,
    field: str | None = None,
) -> None:
    names = tuple(allowed)
    for key in content:
        if key not in names:
            text = f"{message}{nearest(str(key), names)}"
            raise InputError(text, file=file, field=field, found=key)


def _number(parameter: Parameter, value: object, file: object | None) -> object:
    if not parameter.units:
        return value
    if isinstance(value, str):
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
    valid = isinstance(value, int | float) and not isinstance(value, bool)
    # the comparison is false for NaN
    if not valid or not abs(number(value)) <= sys.float_info.max:
        raise InputError("needs a number", file=file, field=parameter.name, found=value)
    return number(value)


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
        stamp = datetime.fromisoformat(str(moment))
        return (stamp if stamp.tzinfo else stamp.replace(tzinfo=UTC)).timestamp()
    except (ValueError, OverflowError) as err:
        raise InputError("is no date", file=file, field="period", found=moment) from err


# ---------------------------------------------------------------------------------- a diagnosis
def active_effects(report: GapReport) -> list[ActiveEffect]:
    """Effects of a diagnosis as the simulation takes them: one entry per aircraft or fleet."""
    entries = [entry for effect in report.effects for entry in _of_effect(effect, report.reference)]
    entries += [entry for place in report.unknown.where for entry in _of_place(place)]
    return parse_effects(json_types(entries))


def _of_effect(effect: EffectEntry, reference: str | None) -> list[dict[str, object]]:
    who = "all" if effect.scope == "fleet" else effect.tails
    # of a pool, of which one member alone may have the effect
    against_all = (effect.by_reference or {}).get(reference or "", effect)
    entry = {"name": effect.name, "period": effect.period}
    if not effect.per_tail:
        return [entry | {"tails": who, "parameters": against_all.parameters}]
    return [
        {"name": effect.name, "period": row.period or effect.period}
        | {"tails": tail, "parameters": row.parameters}
        for tail, row in effect.per_tail.items()
    ]


def _of_place(place: PlaceEntry) -> list[dict[str, object]]:
    curve = place.curve
    if curve.edges is None:
        return []
    table = {"component": place.component, "variables": curve.variables, "edges": curve.edges}
    pieces: Mapping[str, Sequence[float] | None] = curve.per_tail or {"": curve.values}
    return [
        {
            "name": "empirical",
            "tails": tail or place.tails or "all",
            "parameters": table | {"values": values},
            "period": place.period,
        }
        for tail, values in pieces.items()
    ]


def not_known(entries: Sequence[EffectEntry], effects: Sequence[ActiveEffect]) -> list[EffectEntry]:
    """Effects found less those of scatter that were known; one known on some aircraft is kept."""
    out = []
    for entry in entries:
        kind = CATALOGUE[entry.name].kind if entry.name in CATALOGUE else "mean"
        same = [active for active in effects if active.name == entry.name]
        if kind != "second_moment" or not same:
            out.append(entry)
            continue
        known_tails = {tail for active in same for tail in active.tails or entry.tails}
        tails = [tail for tail in entry.tails if tail not in known_tails]
        per_tail = {t: v for t, v in (entry.per_tail or {}).items() if t in tails}
        if tails:
            out.append(replace(entry, tails=tails, per_tail=per_tail))
    return out


def unknown_not_known(unknown: UnknownEntry, effects: Sequence[ActiveEffect]) -> UnknownEntry:
    """Return the unknowns but for known tables that no report can be rid of.

    Where one is left out, the closure of all of them is too.
    """
    components = {e.parameters["component"] for e in effects if e.name == "empirical"}
    places = [p for p in unknown.where if p.component not in components & set(IRREVERSIBLE)]
    if len(places) == len(unknown.where):
        return unknown
    return replace(unknown, present=bool(places), where=places, closure=None)
