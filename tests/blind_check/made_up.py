"""Contents of gap.json written by hand, with the documented keys."""

import json

from tests.report import gap_factories


def claim(name="hard_iron", *, tails=("N401", "N402"), **changes):
    """One entry of ``effects``."""
    defaults = {"parameters": {"amplitude_deg": 2.0, "phase_deg": 30.0}, "ambiguous_with": []}
    return gap_factories.effect(name, *(tails or ()), **defaults | {"share_of_gap": 0.9} | changes)


def place(variable="hour", **changes):
    """One entry of ``unknown.where``."""
    defaults = {"component": "along_heading", "variable": variable, "variables": [variable]}
    return gap_factories.place(**defaults | {"tails": ["N401"], "closure": None} | changes)


def gap(*claims, unknown=(), closure=None):
    """The content of gap.json."""
    closure = closure or {"before": 7.0, "after": 6.5, "reduction_ci": [0.4, 0.6]}
    return {
        "gap": {"mean_vector_disagreement_kt": 7.0, "noise_floor_kt": 6.5, "significance": 0.001},
        "where": [],
        "effects": list(claims),
        "unknown": {"present": bool(unknown), "where": list(unknown)},
        "closure": closure,
    }


def informed(root):
    """A diagnosis that reads the sealed labels of the check in a folder."""

    def diagnosis(config, output, without):
        labels = json.loads((root / "sealed" / "labels.json").read_text())
        label = next(row for row in labels if row["name"] == config.parent.name)
        effects = [claim(**row) for row in label["effects"] if row["name"] not in without]
        closes = label["closure"]["before"] - label["closure"]["after"]
        interval = [closes - 0.1, closes + 0.1]
        return gap(*effects, closure={**label["closure"], "reduction_ci": interval})

    return diagnosis
