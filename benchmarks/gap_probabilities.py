"""Learn what a claim's evidence is worth: the probability that it is right.

    python -m benchmarks.gap_probabilities [--add CHECK ...]

``--add`` takes the claims of a finished ``airswing gap-check`` folder (names stated and names not
confirmed alike, with the numbers their probability is made of and whether they are right) into
``gap_claims.csv``, in place of those of the same check there. A logistic function of these numbers
is fitted to the whole table and written where the diagnosis reads it. Printed is what it would have
stated of archives it was not fitted on (tenths of the archives left out in turn): the table of
stated and right shares, and the log score beside that of the share of right claims alone.

Rows whose source is ``list``: archives of 14 aircraft and 45 days of the check's generator, effects
of the catalogue in their forms and scopes, pairs on the same aircraft, nulls and outside effects;
the search's gates were lowered for them (1 nat, 0.15 m/s), and in half of them the six best names
beyond the gates were put in as well: what passes the gates is nearly always right, and a fit needs
wrong claims. A claim is right where its name is at work on one of its aircraft at least.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from sklearn.linear_model import LogisticRegression

from airswing.blind_check.reliability_table import reliability_rows
from airswing.blind_check.scores import StatedClaim
from airswing.gap.search.belief import FEATURES, WEIGHTS_FILE

Floats = NDArray[np.float64]

CLAIMS = Path(__file__).with_name("gap_claims.csv")
#: Inverse of the penalty on weights (features of unit scatter): about the best log score left out
#: of 0.3 to 100; parts archives are dealt to.
LOOSENESS, PARTS = 10.0, 10


def claims_of(label: Mapping[str, Any], gap: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Rows of one archive of a check.

    Parameters
    ----------
    label : mapping
        Its truth.
    gap : mapping
        Content of gap.json.

    Returns
    -------
    list of dict
    """
    out = []
    for claim in (*gap["effects"], *gap["unconfirmed"]):
        if claim.get("weighed") is None or claim["name"] in label["background"]:
            continue
        own = [e for e in label["effects"] if e["name"] == claim["name"]]
        struck = any(e["tails"] is None or set(e["tails"]) & set(claim["tails"]) for e in own)
        row = {"archive": label["name"], "name": claim["name"], "right": int(struck)}
        out.append(row | dict(zip(FEATURES, claim["weighed"], strict=True)))
    return out


def claims_of_check(folder: Path) -> pd.DataFrame:
    """Rows of all diagnosed archives of a check."""
    scores = json.loads((folder / "scores.json").read_text(encoding="utf-8"))
    rows: list[dict[str, Any]] = []
    for label in scores["labels"]:
        path = folder / "diagnosed" / label["name"] / "gap.json"
        if path.exists():
            rows += claims_of(label, json.loads(path.read_text(encoding="utf-8")))
    out = pd.DataFrame(rows)
    out.insert(0, "source", f"seed {scores['settings']['seed']}")
    return out


def fitted(values: Floats, right: NDArray[np.int64]) -> tuple[float, Floats]:
    """Constant and weights of the logistic function that best tells right claims.

    Parameters
    ----------
    values : (n, f) float
    right : (n,) int

    Returns
    -------
    constant : float
    weights : (f,) float
    """
    spread = np.maximum(values.std(axis=0), 1e-9)
    model = LogisticRegression(C=LOOSENESS, max_iter=1000).fit(values / spread, right)
    return float(model.intercept_[0]), np.asarray(model.coef_[0] / spread)


def left_out(table: pd.DataFrame) -> Floats:
    """Probability of every claim by a fit without the archives of its part, (n,)."""
    values, right = table[list(FEATURES)].to_numpy(float), table["right"].to_numpy(int)
    archive = (table["source"] + table["archive"]).astype("category").cat.codes.to_numpy()
    part = np.random.default_rng(0).permutation(int(archive.max()) + 1)[archive] % PARTS
    out = np.zeros(right.size)
    for k in range(PARTS):
        here = part == k
        constant, weights = fitted(values[~here], right[~here])
        out[here] = 1.0 / (1.0 + np.exp(-(constant + values[here] @ weights)))
    return out


def log_score(stated: Floats, right: NDArray[np.int64]) -> float:
    """Mean log2 of the probability given to what is so; 0 is perfect."""
    given = np.clip(np.where(right == 1, stated, 1.0 - stated), 1e-3, 1.0)
    return float(np.log2(given).mean())


def main() -> None:
    """Add, fit, write, print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--add", type=Path, nargs="*", default=[], metavar="CHECK")
    table = pd.read_csv(CLAIMS)
    for folder in parser.parse_args().add:
        new = claims_of_check(folder)
        table = pd.concat([table[table["source"] != new["source"].iloc[0]], new])
    table.to_csv(CLAIMS, index=False, float_format="%.3f")
    values, right = table[list(FEATURES)].to_numpy(float), table["right"].to_numpy(int)
    constant, weights = fitted(values, right)
    content = {"constant": round(constant, 3)} | {
        name: round(float(weight), 3) for name, weight in zip(FEATURES, weights, strict=True)
    }
    WEIGHTS_FILE.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    print(json.dumps(content))
    stated = left_out(table)
    base = np.full(right.size, right.mean())
    own, alone = log_score(stated, right), log_score(base, right)
    print(f"{right.size} claims, {right.sum()} right; log score left out {own:.3f} bit,")
    print(f"of the share of right claims {alone:.3f}")
    claims = [StatedClaim("name", p, bool(r)) for p, r in zip(stated, right, strict=True)]
    for row in reliability_rows(claims):
        where = f"{row['low']:.2f} to {row['high']:.2f}: {row['claims']} claims"
        print(f"{where}, stated {row['stated']:.3f}, right {row['right']:.3f}")


if __name__ == "__main__":
    main()
