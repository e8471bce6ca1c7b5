"""Everything the reproduction found, as claims.json holds it, and its tables."""

from __future__ import annotations

import csv
import hashlib
import io
import platform
from collections.abc import Sequence
from importlib import metadata
from typing import Any

import numpy as np

import percept
from percept.inference import prediction_interval, tolerance_interval
from percept.report.plain import plain
from percept.reproduce.adaptive import Adapted, TradeOff
from percept.reproduce.claims import Claim
from percept.reproduce.claims.limits import limits_printed
from percept.reproduce.published import Published
from percept.sessions.units import UNITS

SCHEMA = "percept-reproduction/1"

#: Statements of the paper that its published numbers cannot decide, and why.
_UNJUDGED = (
    (
        "Peaks above 300 rad/s come from the device’s flexible modes (Figs 4 and 7).",
        "No mass, damping or mode of the device was published.",
    ),
    (
        "Nonlinear friction and the model of the operator’s hand are ignored (section 2.3).",
        "Neither was measured; absolute stability is judged with every passive hand.",
    ),
    (
        "Users recognise an environment outside its boundary as unreal (section 5).",
        "Subjects adjusted k and b; nobody was asked whether something felt real.",
    ),
)

_PACKAGES = ("numpy", "scipy", "pandas", "matplotlib")


def build_document(
    published: Published, claims: Sequence[Claim], adapted: Adapted, trade: TradeOff
) -> dict[str, Any]:
    """Put everything together as plain values."""
    verdicts = [claim.verdict for claim in claims]
    document = {
        "schema": SCHEMA,
        "provenance": {
            "versions": {
                "percept": percept.__version__,
                "python": platform.python_version(),
                **{name: metadata.version(name) for name in _PACKAGES},
            },
            "files": [
                {"name": path.name, "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
                for path in published.files
            ],
            "device": {"mass": published.device.mass, "damping": published.device.damping},
            "coupling": {"stiffness": published.tuned.stiffness, "damping": published.tuned.damping},
            "period": published.period,
        },
        "counts": {
            verdict: verdicts.count(verdict) for verdict in ("holds", "holds only if", "does not hold")
        },
        "claims": [{"number": number, **plain(claim)} for number, claim in enumerate(claims, start=1)],
        "table": _table(published),
        "future": _future(published, adapted, trade),
        "unjudged": [{"says": says, "why": why} for says, why in _UNJUDGED],
    }
    return dict(plain(document))


def _table(published: Published) -> list[dict[str, Any]]:
    limits, level = published.limits, published.limits.level
    user = prediction_interval(published.moments, level=level)
    share = tolerance_interval(published.moments, level=level)
    moments = published.moments
    rows = []
    places = np.ndindex(len(limits.environments), len(limits.parameters))
    for place, (name, parameter, lower, upper) in zip(places, limits_printed(published), strict=True):
        i, p = place
        rows.append(
            {
                "environment": name,
                "parameter": parameter,
                "unit": UNITS[parameter],
                "reference": str(limits.reference[i][p]),
                "lower_printed": str(limits.lower[i][p]),
                "upper_printed": str(limits.upper[i][p]),
                "lower": lower,
                "upper": upper,
                "mean": float(np.asarray(moments.mean)[place]),
                "sd": float(np.asarray(moments.sd)[place]),
                "user": [float(np.asarray(part)[place]) for part in (user.lower, user.upper)],
                "share": [float(np.asarray(part)[place]) for part in (share.lower, share.upper)],
            }
        )
    return rows


def _future(published: Published, adapted: Adapted, trade: TradeOff) -> dict[str, Any]:
    rows = []
    for wall, region, static, least in zip(
        published.walls, adapted.design.each, adapted.static, trade.least, strict=True
    ):
        rows.append(
            {
                "environment": wall.name,
                "softest": region.softest,
                "stiffest": region.largest,
                "tuned_qualifies": static,
                "least_damping": least,
            }
        )
    return {
        "device": {"mass": adapted.device.mass, "damping": adapted.device.damping},
        "family": published.scene.inference.family,
        "environments": rows,
        "common": {
            "softest": adapted.design.common.softest,
            "stiffest": adapted.design.common.largest,
            "tuned_qualifies": all(adapted.static),
            "least_damping": trade.least_common,
        },
        "tuned_damping": trade.static,
        "trade_off": {"damping": trade.damping, "stiffest": trade.stiffest, "softest": trade.softest},
    }


def claims_csv(claims: Sequence[Claim]) -> str:
    """Return the claims as CSV: one row each, its numbers with all their digits."""
    columns = ("number", "name", "place", "paper", "verdict", "condition", "finding")
    rows: list[tuple[str, ...]] = [(*columns, "margin_name", "margin", "margin_unit", "numbers", "source")]
    for number, claim in enumerate(claims, start=1):
        margin = claim.margin
        others = "; ".join(f"{one.name} = {one.value!r} {one.unit}".rstrip() for one in claim.numbers)
        rows.append(
            (
                str(number),
                *(str(getattr(claim, name)) for name in columns[1:]),
                margin.name,
                repr(float(margin.value)),
                margin.unit,
                others,
                claim.source,
            )
        )
    return _csv(rows)


def table_csv(document: dict[str, Any]) -> str:
    """Return Table 1 as CSV: printed limits, percept's, and those for the next user and a share of all."""
    columns = list(document["table"][0])[:-2]
    rows: list[tuple[str, ...]] = [(*columns, "user_lower", "user_upper", "share_lower", "share_upper")]
    for row in document["table"]:
        limits = (repr(limit) for limit in (*row["user"], *row["share"]))
        rows.append((*(str(row[name]) for name in columns), *limits))
    return _csv(rows)


def _csv(rows: Sequence[tuple[str, ...]]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
