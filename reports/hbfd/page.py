"""The paper, claim by claim, from its published numbers."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np

from percept.inference import prediction_interval, tolerance_interval
from reports.hbfd.claims_table import limits_printed
from reports.hbfd.figures import figures
from reports.hbfd.judging import Claim, Verdict, judge_all, misprints
from reports.hbfd.published import Published, load_published
from reports.page import Page

_TITLE = (
    "“The effect of static virtual couplings on realistic performance of haptic systems”,"
    " claim by claim"
)
_TABLE = """\
Limits of the mean as printed and as percept prints them (k in N/m, b in N·s/m). The paper's reading
of its intervals would have needed the last columns: limits for the next user, and for 99 % of all
users with 95 % confidence. They take the normal law, as the paper does; a negative limit says that
this law does not suit."""


def page(out: Path) -> Page:
    """Judge every claim by the paper's own numbers, and draw its figures.

    Parameters
    ----------
    out : Path
        Folder of the page and its figures.

    Returns
    -------
    Page
    """
    published = load_published()
    claims = judge_all(published)
    device = published.device
    page = Page(
        _TITLE,
        f"This page puts {len(claims)} sentences of the paper to its own published numbers."
        f" {_counted(claims)} Every verdict follows from the numbers given with it: another table"
        " gives other verdicts. No subject's own data were published; only Table 1 is used.",
        "The device's mass and damping were never published. Where they matter, percept tries many"
        f" devices. “The scene's device” ({float(device.mass):g} kg, {float(device.damping):g}"
        " N·s/m) is an illustration.",
        "## Verdicts",
    )
    rows = []
    for number, claim in enumerate(claims, start=1):
        margin = claim.margin
        decided = [margin.name, margin.text] if margin else ["nothing published", ""]
        rows.append([number, f"“{claim.quote}”", claim.verdict, *decided])
    page.table(["No.", "claim", "verdict", "decided by", "value"], rows)
    page.add(f"## Table 1\n\n{_TABLE}")
    heads = ["environment", "parameter", "reference", "LCI printed", "UCI printed"]
    heads += ["LCI", "UCI", "next user", "share of users"]
    page.table(heads, table_rows(published))
    page.add("## Claim by claim")
    for number, claim in enumerate(claims, start=1):
        page.add(f"### {number}. “{claim.quote}”")
        needed = " from published numbers; needed" if claim.verdict == "cannot be judged" else ""
        condition = f"{needed}: {claim.condition}" if claim.condition else ""
        page.add(f"{claim.place}. **{claim.verdict}**{condition}.")
        page.add(claim.finding)
        numbers = [*([claim.margin] if claim.margin else []), *claim.numbers]
        if numbers:
            page.table(["number", "value"], [[one.name, one.text] for one in numbers])
    page.add(
        "## The figures\n\nDrawn with the paper's windows and the illustrative device. The paper's"
        " curves have resonances above 300 rad/s that nobody can draw again."
    )
    for name, says, figure in figures(published):
        page.figure(out, name, figure, says)
    page.add(
        "## Misprints\n\nThe paper prints these and means something else. They are no claims, and"
        " no verdict counts them."
    )
    found = misprints()
    page.table(list(found[0]), [list(one.values()) for one in found])
    return page


def _counted(claims: list[Claim]) -> str:
    """Say how many sentences have each verdict."""
    verdicts = [claim.verdict for claim in claims]
    counts = [f"“{verdict}”: {verdicts.count(verdict)}" for verdict in get_args(Verdict)]
    return f"{', '.join(counts)}."


def table_rows(published: Published) -> Iterator[list[str]]:
    """Return Table 1 as printed, as percept prints it, and with limits for users."""
    limits = published.limits
    of_users = []
    for interval_of in (prediction_interval, tolerance_interval):
        interval = interval_of(limits.moments, level=limits.level)
        of_users.append(np.stack([np.ravel(interval.lower), np.ravel(interval.upper)], axis=1))
    for number, row in enumerate(limits_printed(published)):
        yield row + ["{:.5g} to {:.5g}".format(*ends[number]) for ends in of_users]
