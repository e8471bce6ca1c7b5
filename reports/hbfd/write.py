"""Write the reproduction: page, claims, Table 1 and figures."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from markupsafe import Markup, escape

from percept.haptics import Device
from percept.inference import prediction_interval, tolerance_interval
from percept.provenance import made_by
from percept.report.figures.output import draw_all
from percept.report.page import render_standalone
from percept.results.plain import dumps, plain
from percept.sessions.quantities import IMPEDANCE
from reports.command import write_page
from reports.hbfd.claims_table import limits_printed
from reports.hbfd.figures import drawings
from reports.hbfd.judging import Claim, Verdict, judge_all, misprints
from reports.hbfd.published import Published

PAGE = "reproduction.html"
_SCHEMA = "percept-reproduction/4"
_PACKAGES = ("numpy", "scipy", "pandas", "matplotlib")


@dataclass(frozen=True)
class _Provenance:
    """What the numbers follow from."""

    versions: dict[str, str]
    files: list[dict[str, str]]
    device: dict[str, float]
    coupling: dict[str, float]
    period: float


@dataclass(frozen=True)
class _Row:
    """One quantity of one environment of Table 1."""

    environment: str
    parameter: str
    unit: str
    reference: str  # As printed, as the next two
    lower_printed: str
    upper_printed: str
    lower: str  # As percept prints it, as the next one
    upper: str
    mean: float
    sd: float
    user: list[float]  # Limits for the next user
    share: list[float]  # Limits for a share of all users


@dataclass(frozen=True)
class _Document:
    """All of claims.json."""

    schema: str
    provenance: _Provenance
    counts: dict[str, int]
    claims: list[dict[str, object]]
    table: list[_Row]
    misprints: list[dict[str, str]]


def write_reproduction(published: Published, out: Path, *, command: str) -> list[Claim]:
    """Judge every claim, draw every figure and write both.

    Parameters
    ----------
    published : Published
        As `load_published` reads it.
    out : Path
        Folder, made where it does not exist.
    command : str
        What is run, as the page says it. It is in no other file, as the date and the commit are.

    Returns
    -------
    list of Claim
        Every claim with its verdict.
    """
    claims = judge_all(published)
    made = made_by(command, _PACKAGES)
    document = _document(published, claims, made.versions)
    write_page(out / "claims.json", dumps(plain(document)))
    page = render_standalone(
        "reports.hbfd",
        "reproduction.html.j2",
        draw_all(drawings(published), out / "figures"),
        digits=5,
        symbols=symbols,
        styles=("reproduction.css",),
        document=document,
        claims=claims,
        by_name={claim.name: claim for claim in claims},
        made=made,
    )
    write_page(out / PAGE, page)
    return claims


def symbols(text: str) -> Markup:
    """Set indices, percentages and minus signs as they are read; the rest is escaped."""
    escaped = str(escape(text))
    spaced = re.sub(r"(?<=\d)%", " %", escaped)
    signed = re.sub(r"(?<=[ (])-(?=\d)", "−", spaced)
    indexed = re.sub(r"\b([Zkbm])_(h_vc|eff|[hecd])(?![a-z])", _index, signed)
    return Markup(indexed.replace("k_cT", "k<sub>c</sub>T"))


def _index(match: re.Match[str]) -> str:
    return f"{match[1]}<sub>{match[2].replace('_', ',')}</sub>"


def _document(published: Published, claims: Sequence[Claim], versions: dict[str, str]) -> _Document:
    """Put everything together, as claims.json holds it."""
    verdicts = [claim.verdict for claim in claims]
    counts = {verdict: verdicts.count(verdict) for verdict in get_args(Verdict)}
    numbered = []
    for number, claim in enumerate(claims, start=1):
        numbered.append({"number": number, **plain(claim)})
    files = []
    for path in published.files:
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        files.append({"name": path.name, "sha256": digest})
    tuned = published.tuned
    coupling = {"stiffness": float(tuned.stiffness), "damping": float(tuned.damping)}
    device = _device(published.device)
    provenance = _Provenance(versions, files, device, coupling, published.period)
    table = _table(published)
    return _Document(_SCHEMA, provenance, counts, numbered, table, misprints())


def _device(device: Device) -> dict[str, float]:
    return {"mass": float(device.mass), "damping": float(device.damping)}


def _table(published: Published) -> list[_Row]:
    """Return Table 1 as printed, as percept prints it, and with limits for users."""
    limits = published.limits
    moments = limits.moments
    user = prediction_interval(moments, level=limits.level)
    share = tolerance_interval(moments, level=limits.level)
    mean = np.asarray(moments.mean)
    sd = np.asarray(moments.sd)
    # (environments, quantities, 2): lower and upper.
    of_user = np.stack([np.asarray(user.lower), np.asarray(user.upper)], axis=-1)
    of_share = np.stack([np.asarray(share.lower), np.asarray(share.upper)], axis=-1)
    rows = []
    for row, (i, p) in zip(limits_printed(published), np.ndindex(mean.shape), strict=True):
        rows.append(
            _Row(
                row.environment,
                row.parameter,
                IMPEDANCE[row.parameter].unit,
                str(limits.reference[i][p]),
                str(limits.lower[i][p]),
                str(limits.upper[i][p]),
                row.lower,
                row.upper,
                float(mean[i, p]),
                float(sd[i, p]),
                of_user[i, p].tolist(),
                of_share[i, p].tolist(),
            )
        )
    return rows
