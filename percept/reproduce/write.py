"""Write the reproduction: page, claims, Table 1 and figures."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from percept.files import FolderFiles, filled_folder, warned
from percept.inference import prediction_interval, tolerance_interval
from percept.provenance import made_by
from percept.reproduce.claims_table import limits_printed
from percept.reproduce.devices import Adapted, adapted_couplings
from percept.reproduce.judging import Claim, Verdict, judge_all, sentences
from percept.reproduce.published import Published
from percept.results.plain import dumps, plain
from percept.sessions.quantities import IMPEDANCE

PAGE = "reproduction.html"
SCHEMA = "percept-reproduction/3"

_FIGURES = ("design", "device-maps", "fig-*")
_FILES = FolderFiles(
    PAGE,
    (PAGE, "claims.json", "claims.csv", "table1.csv", *(f"figures/{f}.svg" for f in _FIGURES)),
)
_PACKAGES = ("numpy", "scipy", "pandas", "matplotlib")


def write_reproduction(
    published: Published,
    out_dir: str | Path,
    *,
    command: str = "percept reproduce",
    force: bool = False,
    say: Callable[[str], None] = warned,
) -> list[Claim]:
    """Judge every claim, draw every figure and write both.

    Parameters
    ----------
    published : Published
        As `load_published` reads it.
    out_dir : str or Path
        Folder, made where it does not exist; files of other names in it stay.
    command : str, optional
        What is run, as the page says it. It is in no other file, as the date and the commit are.
    force : bool
        Replace also files of these names that no earlier run wrote.
    say : callable
        Told of each edited file that is kept as NAME.bak; a warning by default.

    Returns
    -------
    list of Claim
        Every claim with its verdict.

    Raises
    ------
    UsageError
        Where the folder is a file or cannot be written, or a name in it is taken by a file that
        no earlier run wrote.
    """
    # The drawing library waits for whoever draws.
    from percept.report.figures.output import draw_all
    from percept.report.page import render_standalone
    from percept.reproduce.figures import drawings

    with filled_folder(out_dir, _FILES, force=force, say=say) as folder:
        claims = judge_all(published)
        adapted = adapted_couplings(published)
        made = made_by(command, _PACKAGES)
        document = _document(published, claims, adapted, made.versions)
        texts = {
            "claims.json": dumps(document),
            "claims.csv": _claims_csv(document["claims"]),
            "table1.csv": _table_csv(document["table"]),
        }
        for name, text in texts.items():
            (folder / name).write_text(text, encoding="utf-8")
        page = render_standalone(
            "percept.reproduce",
            "reproduction.html.j2",
            draw_all(drawings(published, adapted), folder / "figures"),
            digits=5,
            symbols=symbols,
            styles=("reproduction.css",),
            document=document,
            claims=claims,
            by_name={claim.name: claim for claim in claims},
            made=made,
        )
        (folder / PAGE).write_text(page, encoding="utf-8")
    return claims


def symbols(text: str) -> Markup:
    """Set indices, percentages and minus signs as they are read; the rest is escaped."""
    found = re.sub(
        r"\b([Zkbm])_(h_vc|eff|[hecd])(?![a-z])",
        lambda match: f"{match[1]}<sub>{match[2].replace('_', ',')}</sub>",
        re.sub(r"(?<=[ (])-(?=\d)", "−", re.sub(r"(?<=\d)%", " %", str(escape(text)))),
    )
    return Markup(found.replace("k_cT", "k<sub>c</sub>T"))


def _document(
    published: Published, claims: Sequence[Claim], adapted: Adapted, versions: dict[str, str]
) -> dict[str, Any]:
    """Put everything together as plain values, as claims.json holds it."""
    verdicts = [claim.verdict for claim in claims]
    document = {
        "schema": SCHEMA,
        "provenance": {
            "versions": versions,
            "files": [
                {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
                for path in published.files
            ],
            "device": {"mass": published.device.mass, "damping": published.device.damping},
            "coupling": {
                "stiffness": published.tuned.stiffness,
                "damping": published.tuned.damping,
            },
            "period": published.period,
        },
        "counts": {verdict: verdicts.count(verdict) for verdict in get_args(Verdict)},
        "claims": [
            {"number": number, **plain(claim)} for number, claim in enumerate(claims, start=1)
        ],
        "table": _table(published),
        "future": _future(published, adapted),
        "misprints": sentences()["misprint"],
    }
    return dict(plain(document))


def _table(published: Published) -> list[dict[str, Any]]:
    limits, moments = published.limits, published.limits.moments
    user = prediction_interval(moments, level=limits.level)
    share = tolerance_interval(moments, level=limits.level)
    printed = {
        "reference": limits.reference, "lower_printed": limits.lower, "upper_printed": limits.upper,
    }  # fmt: skip
    rows = []
    cells = np.ndindex(len(limits.environments), len(limits.parameters))
    for at, (name, parameter, lower, upper) in zip(cells, limits_printed(published), strict=True):
        mean, sd, *ends = (
            float(np.asarray(each)[at])
            for each in (moments.mean, moments.sd, user.lower, user.upper, share.lower, share.upper)
        )
        rows.append(
            {
                "environment": name,
                "parameter": parameter,
                "unit": IMPEDANCE[parameter].unit,
                **{column: str(values[at[0]][at[1]]) for column, values in printed.items()},
                "lower": lower,
                "upper": upper,
                "mean": mean,
                "sd": sd,
                "user": ends[:2],
                "share": ends[2:],
            }
        )
    return rows


def _future(published: Published, adapted: Adapted) -> dict[str, Any]:
    rows = [
        *zip(
            (wall.name for wall in published.walls),
            adapted.design.each,
            adapted.static,
            strict=True,
        ),
        ("one for all", adapted.design.common, all(adapted.static)),
    ]
    return {
        "device": {"mass": adapted.device.mass, "damping": adapted.device.damping},
        "family": published.scene.inference.family,
        "environments": [
            {
                "environment": name,
                "softest": region.softest,
                "stiffest": region.largest,
                "tuned_qualifies": qualifies,
            }
            for name, region, qualifies in rows
        ],
        "tuned_damping": published.needed(published.tuned),
    }


def _claims_csv(claims: Sequence[dict[str, Any]]) -> str:
    """Return the claims as CSV: one row each, its numbers with all their digits."""
    rows = []
    for claim in claims:
        margin = claim["margin"] or {"name": "", "value": None, "unit": ""}
        others = (
            f"{one['name']} = {one['value']!r} {one['unit']}".rstrip() for one in claim["numbers"]
        )
        about = {
            "margin_name": margin["name"],
            "margin": margin["value"],
            "margin_unit": margin["unit"],
        }
        rows.append({**claim, **about, "numbers": "; ".join(others)})
    return pd.DataFrame(rows).to_csv(index=False, lineterminator="\n")


def _table_csv(rows: Sequence[dict[str, Any]]) -> str:
    """Return Table 1 as CSV: printed limits, percept's, and those for the next user and a share of all."""
    table = pd.DataFrame(rows).drop(columns=["user", "share"])
    for kind in ("user", "share"):
        table[[f"{kind}_lower", f"{kind}_upper"]] = [row[kind] for row in rows]
    return table.to_csv(index=False, lineterminator="\n")
