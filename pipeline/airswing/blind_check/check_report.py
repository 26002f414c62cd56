"""The check as a document: Markdown for the record, an HTML page with its figure.

Assumes a finished `Check`. Every number is shown, met or not; shares with the number of cases
behind them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from airswing.blind_check.check_summary import (
    Group,
    baseline_rows,
    grouped,
    hard_and_real,
    of_default,
    short_nulls,
    summarise,
    targets,
)
from airswing.blind_check.reliability_table import reliability_rows
from airswing.blind_check.scores import Score

if TYPE_CHECKING:
    from airswing.blind_check.check_run import Check

__all__ = ["as_markdown", "short_text", "write_reports"]

_COLUMNS = (
    ("cases", "cases", "d"),
    ("detected", "detected", "%"),
    ("first_right", "first name right", "%"),
    ("all_named", "named at all", "%"),
    ("in_set", "truth in set", "%"),
    ("set_size", "set size", ".2f"),
    ("extra_names", "false name beside", "%"),
    ("precision", "aircraft precision", ".2f"),
    ("recall", "recall", ".2f"),
    ("jaccard", "Jaccard", ".2f"),
    ("parameter_error", "parameter error", "%"),
    ("date_error", "date error, d", ".1f"),
    ("closure_error", "closure error, kt", ".3f"),
    ("closure_covered", "interval covers", "%"),
    ("unknown", "unknown raised", "%"),
    ("log_score", "log score, bit", ".3f"),
)


def _text(value: float | None, form: str) -> str:
    if value is None:
        return "–"
    if form == "%":
        return f"{100 * value:.0f} %"
    return format(value, form)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def _group_table(title: str, groups: Mapping[Group, Mapping[str, float | None]]) -> str:
    rows = [
        [str(name), *(_text(found[key], form) for key, _, form in _COLUMNS)]
        for name, found in groups.items()
    ]
    return _table([title, *(name for _, name, _ in _COLUMNS)], rows)


_TARGET_COLUMNS = ("", "target", "default archives", "cases", "", "every rung", "cases")


def _target_text(sense: str, target: float | Sequence[float], form: str) -> str:
    if isinstance(target, Sequence):
        return f"{_text(target[0], form)} to {_text(target[1], form)}"
    return ("at least " if sense == ">=" else "at most ") + _text(target, form)


def _target_rows(scores: Sequence[Score]) -> list[list[str]]:
    """Targets by row: they are set for default archives; every rung together beside them."""
    rows = []
    for entry, whole in zip(targets(of_default(scores)), targets(scores), strict=True):
        plain = entry["what"].endswith((", kt", ", days"))
        form = ".3g" if plain else "%"
        met = {True: "met", False: "not met", None: "no case"}[entry["met"]]
        rows.append(
            [
                entry["what"],
                _target_text(entry["sense"], entry["target"], form),
                _text(entry["reached"], form),
                str(entry["cases"]),
                met,
                _text(whole["reached"], form),
                str(whole["cases"]),
            ]
        )
    beside = (
        ("hard world and real errors, 0.4 m/s and more: first name right", "at least 80 %"),
        ("claims on nulls of two weeks", "at most 2 %"),
    )
    for told, (share, number) in zip(
        beside, (hard_and_real(scores), short_nulls(scores)), strict=True
    ):
        rows.append([*told, "–", "0", "–", _text(share, "%"), str(number)])
    return rows


def as_markdown(check: Check, *, command: str, proof: Mapping[str, float] | None = None) -> str:
    """Return the record of a check.

    Parameters
    ----------
    check : Check
        From `airswing.blind_check.gap_check`.
    command : str
        What repeats it.
    proof : mapping, optional
        Numerical errors of the generator (rung 0), m/s.
    """
    scores, settings = check.scores, check.settings
    withheld = [s for s in scores if s["kind"] in ("single", "pair")]
    singles = [s for s in withheld if s["kind"] == "single"]
    parts = [
        "# Blind check of the gap diagnosis",
        f"`{command}`: {_of_all(check)} sealed archives of {settings['aircraft']} aircraft and "
        f"{settings['days']} days (one day on the real forecast), diagnosed through `airswing gap` "
        f"alone. Digest of the labels, published before the first diagnosis: `{check.digest}`.",
        "Rungs: 1 ordinary world, 2 hard world, 3 pairs, 4 outside or removed from the catalogue, "
        "5 real sensor or forecast errors with an effect added. Sizes are m/s root mean square "
        "where the effect acts. Outside effects are drawn at random. The truth of a closure is the "
        "archive's twin: the same reports made without the effect. What a world has beside the "
        "effect (1 % gross errors in the hard one, a real valve's irregular heading errors on all "
        "aircraft) is neither right nor wrong to name; all else that is not the effect is wrong.",
        "## Against the targets",
        "The targets are set for default archives: the ordinary world, six weeks, no real errors. "
        "Beside them stand all cases: two weeks, the hard world's and real errors' among them.",
        _table(_TARGET_COLUMNS, _target_rows(scores)),
    ]
    if proof:
        parts += [
            "## Rung 0: the generator's own numerical error, m/s",
            _table(["", "rms"], [[k, f"{v:.4f}"] for k, v in proof.items()]),
        ]
    if check.baselines:
        parts += ["## Beside simple methods", _baseline_table(check)]
    parts += ["## What stated probabilities are worth", _reliability_table(scores)]
    parts += ["## Outside the catalogue", _outside_table(scores)]
    parts += ["## Removed from the catalogue", _removed_table(scores)]
    parts += [
        f"## By {by}\n\n{_group_table(title, grouped(cases, by))}"
        for by, title, cases in (
            ("effect", "effect", withheld),
            ("variant", "variant", withheld),
            ("size", "m/s", singles),
            ("rung", "rung", withheld),
        )
    ]
    parts += ["All of them: " + _one_line(summarise(withheld))]
    parts += ["## Nulls", _null_text(scores)]
    parts += ["## Every case", _case_table(check)]
    if check.failures:
        parts += ["## Diagnoses that failed"]
        parts += ["\n".join(f"- {name}: {text}" for name, text in check.failures.items())]
    return "\n\n".join(parts) + "\n"


def _of_all(check: Check) -> str:
    sealed, done = check.settings.get("sealed"), len(check.scores)
    return str(done) if sealed in (None, done) else f"{done} of {sealed}"


def _one_line(found: Mapping[str, float | None]) -> str:
    return ", ".join(f"{name} {_text(found[key], form)}" for key, name, form in _COLUMNS) + "."


def _baseline_table(check: Check) -> str:
    rows = [
        [
            row["method"],
            *(
                _text(share, "%")
                for share in (
                    row["detected"],
                    row["first_right"],
                    row["extra_names"],
                    row["false_alarms"],
                )
            ),
            f"{row['singles']} / {row['nulls']}",
        ]
        for row in baseline_rows(check.scores, check.baselines)
    ]
    return _table(
        [
            "method",
            "detected",
            "first name right",
            "false name beside",
            "claims on nulls",
            "singles / nulls",
        ],
        rows,
    )


def _reliability_table(scores: Sequence[Score]) -> str:
    """Stated probabilities by bin: of names, of unknowns, and of both together."""
    claims = [c for s in of_default(scores) if not s.get("failure") for c in s["claims"]]
    rows = [
        [
            kind,
            f"{row['low']:g} to {row['high']:g}",
            str(row["claims"]),
            _text(row["stated"], ".3f"),
            _text(row["right"], ".3f"),
        ]
        for kind in ("name", "unknown", "name and unknown")
        for row in reliability_rows([c for c in claims if c.kind in kind.split(" and ")])
    ]
    return _table(["claim", "stated", "claims", "stated, mean", "right"], rows)


def _outside_table(scores: Sequence[Score]) -> str:
    rows = []
    cases = [(true, s) for s in _done(scores, "outside") if (true := s["outside"]) is not None]
    for true, s in sorted(cases, key=lambda case: (case[0]["shape"], case[1]["size"])):
        rows.append(
            [
                s["name"],
                true["component"],
                true["shape"],
                " x ".join(true["variables"]),
                true["scope"],
                f"{s['size']:.2g}",
                _text(true["named_share"], "%"),
                _yes(s["unknown"]),
                _yes(s["unknown_first"]),
                _yes(s.get("variable_first")),
                _yes(s.get("variable_near")),
                _text(s.get("unknown_precision"), ".2f"),
                _text(s.get("unknown_recall"), ".2f"),
                ", ".join(s["claimed"]) or "–",
                _text(s["unknown_closure_stated"], ".2f"),
                _text(s["closure_true"], ".2f"),
                _yes(s["unknown_closure_covered"]),
            ]
        )
    return _table(
        [
            "case",
            "component",
            "shape",
            "by",
            "on",
            "m/s",
            "has a name",
            "unknown",
            "no false name ahead",
            "variable first",
            "or one as good",
            "precision",
            "recall",
            "named instead",
            "closure stated, kt",
            "true, kt",
            "interval holds",
        ],
        rows,
    )


def _done(scores: Sequence[Score], kind: str) -> list[Score]:
    return [s for s in scores if s["kind"] == kind and not s.get("failure")]


def _removed_table(scores: Sequence[Score]) -> str:
    rows = [
        [
            s["name"],
            ", ".join(s["focus"]),
            f"{s['size']:g}",
            _yes(s["unknown"]),
            _yes(s["placed"]),
            ", ".join(s["claimed"]) or "–",
            _text(s["closure_stated"], ".2f"),
            _text(s["closure_true"], ".2f"),
        ]
        for s in sorted(_done(scores, "removed"), key=lambda s: s["focus"])
    ]
    return _table(
        [
            "case",
            "effect",
            "m/s",
            "unknown",
            "placed",
            "named instead",
            "closure stated, kt",
            "true, kt",
        ],
        rows,
    )


def _null_text(scores: Sequence[Score]) -> str:
    nulls = [s for s in scores if s["kind"] == "null" and not s["failure"]]
    loud = [s for s in nulls if s["false_names"] or s["unknown"]]
    lines = [f"{len(loud)} of {len(nulls)} nulls raised a claim."]
    lines += [
        f"- {s['name']} (rung {s['rung']}, {s['world']}): "
        + (", ".join(s["claimed"]) or "no name")
        + (", unknown" if s["unknown"] else "")
        for s in loud
    ]
    real = [s["name"] for s in nulls if s.get("of_background") and s not in loud]
    if real:
        lines.append(
            f"\nNot counted: an unknown across the heading or of scatter on "
            f"{', '.join(real)}: all aircraft have a real flux "
            "valve's irregular heading error there."
        )
    return "\n".join(lines)


def _unknown_text(score: Score) -> str:
    if score["unknown"]:
        return " + unknown"
    return " (unknown of the record)" if score.get("of_background") else ""


def _case_table(check: Check) -> str:
    rows = []
    for label, score in zip(check.labels, check.scores, strict=True):
        told = score.get("failure") or (
            ", ".join(score["claimed"]) + _unknown_text(score) or "nothing"
        )
        right = "–" if label["kind"] in ("null", "outside") else _yes(score.get("first_right"))
        rows.append(
            [
                label["name"],
                str(label["rung"]),
                label["kind"],
                label["variant"],
                label["world"],
                ", ".join(label["focus"]) or "–",
                ", ".join(f"{v:.2g}" for v in label["sizes"]),
                str(told),
                right,
                _text(score.get("jaccard"), ".2f"),
                _text(score.get("parameter_error"), "%"),
            ]
        )
    return _table(
        [
            "case",
            "rung",
            "kind",
            "variant",
            "world",
            "truth",
            "m/s",
            "diagnosis",
            "first right",
            "Jaccard",
            "parameter error",
        ],
        rows,
    )


def _yes(value: bool | None) -> str:
    return "yes" if value else "no"


def short_text(check: Check) -> str:
    """Return the targets as lines for a terminal."""
    return "\n".join(
        f"{row[4]:>8}  {row[0]}: {row[2]} (target {row[1]}; {row[3]} cases; every rung "
        f"{row[5]}, {row[6]})"
        for row in _target_rows(check.scores)
    )


def write_reports(
    output: Path, check: Check, *, command: str, proof: Mapping[str, float] | None = None
) -> Path:
    """Write ``gap_check.md``, ``gap_check.html`` and ``gap_check.png``.

    Parameters
    ----------
    command : str
        What repeats it.
    proof : mapping, optional
        Rung 0.
    """
    from airswing.blind_check.check_figures import check_figure
    from airswing.products.whole_files import write_text
    from airswing.report.html.document import Column, Row, Section, document, table
    from airswing.report.html.embed import embedded
    from airswing.report.html.style import png_bytes

    figure = check_figure(check.scores)
    (output / "gap_check.png").write_bytes(png_bytes(figure))
    write_text(output / "gap_check.md", as_markdown(check, command=command, proof=proof))
    words = [Column("", "words"), *(Column(name) for name in _TARGET_COLUMNS[1:])]
    groups = [
        Section(
            f"by-{by}",
            f"By {by}",
            parts=[
                table(
                    [Column(by, "words"), *(Column(name) for _, name, _ in _COLUMNS)],
                    [
                        Row([str(name), *(_text(found[key], form) for key, _, form in _COLUMNS)])
                        for name, found in grouped(check.scores, by).items()
                    ],
                )
            ],
        )
        for by in ("effect", "variant", "size", "rung")
    ]
    reached = targets(of_default(check.scores))
    met = [entry["met"] for entry in reached if entry["met"] is not None]
    page = document(
        title="Blind check of the gap diagnosis",
        kicker="airswing gap-check",
        headline=f"{sum(met)} of {len(met)} targets met on default archives, "
        f"{len(check.scores)} sealed cases in all.",
        facts=[("Command", command), ("Digest of the labels", check.digest)],
        sections=[
            Section("figure", "At a glance", parts=[embedded(figure)]),
            Section(
                "targets",
                "Against the targets",
                parts=[table(words, [Row(row) for row in _target_rows(check.scores)])],
            ),
            *groups,
        ],
    )
    return write_text(output / "gap_check.html", page)
