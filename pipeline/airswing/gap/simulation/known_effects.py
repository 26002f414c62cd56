"""Known effects: read from a file of effects or from fitted deviations, and taken off reports.

Assumptions: an archive whose simulation has an effect parts from that simulation as the archive
with the effect taken off parts from a simulation without it. Errors of heading and airspeed are
taken off exactly: the unit indicated ``psi`` and ``V``, so it flew ``psi - d(psi)`` at the airspeed
it would indicate as ``V``, and the wind it would have sent differs by
``V h(psi) - V_true h(psi - d)``. What acts on the wind met (the reference's errors, a height or a
time that is off) is put into the reference wind; exchanged identifiers are given back. A table of
what nobody could name (``empirical``) is taken off the wind sent, in rounds. Effects of scatter
(coding, gross errors, a floor of the speeds sent) cannot be taken off report by report: they stay,
and are not stated again.

Units: those of `airswing.gap.archive.frame` and of the catalogue's parameters.

Source of the deviation's terms: coefficients A-E of ``fits.nc``, see
`airswing.compass.fit.deviation`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from airswing.errors import InputError
from airswing.flags import published
from airswing.gap.archive.frame import Frame
from airswing.gap.effects import EMPIRICAL, ActiveEffect, State
from airswing.gap.simulation.effects_file import read_effects
from airswing.gap.simulation.forward import Work, affected_reports, apply_stage, prepared
from airswing.physics.triangle import bearing, wrap_positive, wrap_signed

__all__ = ["effects_of_fits", "read_known", "take_off_known"]

FloatArray = NDArray[np.float64]
AIRSPEED_STEPS = 8
"""Fixed-point steps from indicated to true airspeed: errors of 10 % settle below 1e-5 m/s."""


def read_known(path: Path | str, *, reference: str) -> list[ActiveEffect]:
    """Read known effects from ``effects.yaml``, or the deviations of ``fits.nc`` as effects.

    Parameters
    ----------
    path : path-like
        A file that ends with ``.nc`` holds fits, any other effects.
    reference : str
        Reference or pool whose fits are taken.

    Raises
    ------
    InputError
        The file is not there, or holds neither.
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
    """Return the accepted fits of every aircraft as effects.

    Parameters
    ----------
    fits : xarray.Dataset
        Content of ``fits.nc``.
    reference : str
        Reference or pool; the only one there is, where another was fitted alone.
    file : Path, optional
        Named in messages.

    Returns
    -------
    list of ActiveEffect
        Offset, hard iron (at the field the coefficients are stated at), soft iron and airspeed
        scale of each aircraft whose fit was accepted.

    Raises
    ------
    InputError
        The reference was not fitted, or no fit was accepted.
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
    own = fits.isel(reference=names.index(reference))
    out: list[ActiveEffect] = []
    for k, tail in enumerate(str(name) for name in own["aircraft"].values):
        one = own.isel(aircraft=k)
        if published(one["status"]) and bool(np.isfinite(one["deviation"]).all()):
            out += _deviation_effects(one, tail)
    if not out:
        raise InputError("no accepted fit to start from", file=file, field="status")
    return out


def _deviation_effects(fit: xr.Dataset, tail: str) -> list[ActiveEffect]:
    """Return one aircraft's curve A + B sin + C cos + D sin 2 + E cos 2 as effects, degrees."""
    a, b, c, d, e = (float(value) for value in fit["deviation"].values)
    field = float(fit["mean_horizontal_field"])
    found: list[tuple[str, Mapping[str, object]]] = [("compass_offset", {"offset_deg": a})]
    if b != 0.0 or c != 0.0:
        found.append(("hard_iron", _cycle(b, c) | {"at_horizontal_field_nT": field}))
    if d != 0.0 or e != 0.0:
        found.append(("soft_iron", _cycle(d, e)))
    scale = float(fit["airspeed_scale"])
    if np.isfinite(scale):
        found.append(("tas_scale", {"scale_percent": 100.0 * scale}))
    return [ActiveEffect(name, values, (tail,)) for name, values in found]


def _cycle(sine: float, cosine: float) -> dict[str, float]:
    return {
        "amplitude_deg": float(np.hypot(sine, cosine)),
        "phase_deg": float(np.degrees(np.arctan2(cosine, sine))),
    }


def _start(frame: Frame) -> State:
    """Return the measurement as it stands: what effects change is read off afterwards."""
    return State(
        airframe=frame.aircraft.copy(),
        wind_u=frame.u_ref,
        wind_v=frame.v_ref,
        heading_error=np.zeros(frame.size),
        airspeed=frame.airspeed,
        report_u=frame.u_rep,
        report_v=frame.v_rep,
        latitude=frame.latitude,
        longitude=frame.longitude,
    )


def take_off_known(frame: Frame, effects: Sequence[ActiveEffect]) -> Frame:
    """Return the archive that parts from a simulation without effects as this one from theirs.

    Parameters
    ----------
    effects : sequence of ActiveEffect
        What the simulation has; aircraft that are not in the archive must not be named.

    Returns
    -------
    Frame
        The same reports in the same order.

    Raises
    ------
    InputError
        An effect or an aircraft is unknown, or the context an effect acts on is absent.
    """
    seeds = np.random.SeedSequence(0).spawn(len(effects))
    work = [prepared(active, frame, s) for active, s in zip(effects, seeds, strict=True)]
    frame = _before_tables(frame, work)
    state = apply_stage(_start(frame), frame, work, "identity")
    given_back = replace(frame, aircraft=state.airframe)
    met = apply_stage(replace(_start(frame), airframe=state.airframe), frame, work, "atmosphere")
    error, airspeed = _sensor(given_back, work)
    heading = frame.heading - error
    change = frame.airspeed * np.stack([np.sin(frame.heading), np.cos(frame.heading)])
    change = change - airspeed * np.stack([np.sin(heading), np.cos(heading)])
    return replace(
        given_back,
        u_ref=met.wind_u,
        v_ref=met.wind_v,
        u_rep=frame.u_rep + change[0],
        v_rep=frame.v_rep + change[1],
        heading=heading,
        airspeed=airspeed,
        magnetic_heading=wrap_positive(frame.magnetic_heading - error),
    )


def _before_tables(frame: Frame, work: Sequence[Work]) -> Frame:
    """Return the reports as they would have been sent without the tables on the wind sent."""
    tables = [w for w in work if w.active.name == EMPIRICAL.name]
    if not tables:
        return frame
    state = _start(frame)
    for one in reversed(tables):
        affected = affected_reports(one, state, frame)
        before = EMPIRICAL.undo(state, frame, one.values)
        u = np.where(affected, before.report_u, state.report_u)
        v = np.where(affected, before.report_v, state.report_v)
        state = replace(state, report_u=u, report_v=v)
    u, v = state.report_u, state.report_v
    # heading and airspeed move by as much as the air vector: they need not close its triangle
    sent = np.stack([frame.ground_u - frame.u_rep, frame.ground_v - frame.v_rep])
    air = np.stack([frame.ground_u - u, frame.ground_v - v])
    turned = wrap_signed(bearing(*air) - bearing(*sent))
    return replace(
        frame,
        u_rep=u,
        v_rep=v,
        heading=frame.heading + turned,
        airspeed=frame.airspeed + np.hypot(*air) - np.hypot(*sent),
        magnetic_heading=wrap_positive(frame.magnetic_heading + turned),
    )


def _sensor(frame: Frame, work: Sequence[Work]) -> tuple[FloatArray, FloatArray]:
    """Return the error (n,) of the indicated heading, rad, and the true airspeed (n,), m/s."""
    start = _start(frame)
    true = frame.airspeed
    after = start
    for _ in range(AIRSPEED_STEPS):
        after = apply_stage(replace(start, airspeed=true), frame, work, "sensor")
        true = true - (after.airspeed - frame.airspeed)
    return after.heading_error, true
