"""Parts of a diagnosis that the small real product does not have, and the arrays of gap.nc."""

from __future__ import annotations

from dataclasses import replace

from airswing.gap.result.schema import (
    ClosesEntry,
    CurveEntry,
    EffectEntry,
    EvidenceEntry,
    PlaceEntry,
    RivalEntry,
    SliceEntry,
)


def effect(name: str, *tails: str, **given: object) -> EffectEntry:
    """Return an effect found on aircraft."""
    made = EffectEntry(name, 0.99, list(tails), {}, {}, None, "aircraft", 40.0)
    return replace(made, **given)  # type: ignore[arg-type]


def rival() -> RivalEntry:
    """Return an effect that could not be told from another."""
    return RivalEntry("soft_iron", 2.1, "headings in more compass points")


def slice_entry(variable: str, values: list[str], share: float, q_value: float) -> SliceEntry:
    """Return one slice of the gap."""
    curve = CurveEntry(["offset"], [0.4])
    return SliceEntry(variable, "both", values, share, q_value, q_value / 2, 90.0, "", curve)


def unknown_place() -> PlaceEntry:
    """Return the place of an effect that the catalogue does not hold."""
    return PlaceEntry(
        component="cross",
        variable="icing",
        variables=["icing", "magnetic_heading"],
        group="cross:icing*heading",
        tails=["N403"],
        scope="aircraft",
        evidence_nats=30.0,
        size_m_s=1.2,
        curve=CurveEntry(["on", "on sin", "on cos"], [0.1, 1.4, -0.3]),
        closure=ClosesEntry(0.12, [0.05, 0.2]),
    )


def unknown_table() -> PlaceEntry:
    """Return the table of an unknown over two variables."""
    curve = CurveEntry(
        labels=["low; cold", "low; warm", "high; cold", "high; warm"],
        m_s=[0.1, 1.4, -0.3, 0.2],
        unit="m/s",
        variables=["altitude", "temperature"],
        variable_units=["km", "K"],
        edges=[[0.0, 4.0, 12.0], [210.0, 250.0, 300.0]],
        values=[0.1, 1.4, -0.3, 0.2],
    )
    variables = ["altitude", "temperature"]
    return replace(unknown_place(), variable="altitude", variables=variables, curve=curve)


def evidence(aircraft: int = 14) -> list[EvidenceEntry]:
    """Return rows of the evidence table: two effects on single aircraft, their rivals."""
    none = [0.01] * aircraft

    def row(name: str, nats: float, instead: str | None) -> EvidenceEntry:
        return EvidenceEntry(instead, name, "aircraft", True, [0], nats, 2 * nats, 2.0, none)

    return [
        replace(row("hard_iron", 5230.0, "hard_iron"), posterior=[*none[:-1], 0.99]),
        row("soft_iron", 320.0, "hard_iron"),
        row("compass_step", 400.0, "compass_step"),
        row("hard_iron", 12.0, "compass_step"),
        replace(row("tas_scale", -2.0, None), scope="fleet", posterior=[]),
        replace(row("cross:icing*heading", 9000.0, None), known=False),
    ]
