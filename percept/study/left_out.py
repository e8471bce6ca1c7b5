"""Every environment predicted from the others, and set against what its own users did."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from percept.errors import RefusalError
from percept.inference.classical.moments import Moments
from percept.inference.record import percent
from percept.study.classical import cell_moments
from percept.study.prediction import NO_PLACE, Prediction, expected_users, predict
from percept.study.responses import refuse_no_ratio

if TYPE_CHECKING:
    from percept.inference.hierarchy.density import ConditionalMoments
    from percept.study.study import Study

Array = NDArray[np.float64]
_FEWEST = 3


@dataclasses.dataclass(frozen=True, eq=False)
class LeftOut:
    """Predictions of environments that the model had not seen, against what was found there."""

    family: str  # Of the model
    level: float  # Of the intervals
    rows: pd.DataFrame  # environment, parameter
    skipped: tuple[tuple[str, str], ...] = ()  # Environments without a prediction, and why

    @property
    def sentence(self) -> str:
        """How many observed means the predictions hold."""
        held = int(self.rows["inside"].sum()) if len(self.rows) else 0
        said = (
            f"{held} of {len(self.rows)} observed means lie inside the {percent(self.level)} interval of the "
            "average user predicted from the other environments."
        )
        outside = [
            f"{row.parameter} of {row.environment}" for row in self.rows.itertuples() if not row.inside
        ]
        return f"{said} Outside: {', '.join(outside)}." if outside else said

    def _repr_html_(self) -> str:
        return f"<p>{html.escape(self.sentence)}</p>{self.rows.to_html(index=False, escape=True)}"


def leave_one_environment_out(study: Study) -> LeftOut:
    """Predict each environment from a fit to all others, and compare with its users."""
    if len(study.environments) < _FEWEST:
        raise RefusalError(
            f"leaving one of {len(study.environments)} environments out leaves no trend to predict from; "
            f"{_FEWEST} are needed."
        )
    if study.scene.inference.method == "classical":
        raise RefusalError(
            "the classical method has no model of environments nobody tested.",
            hint='Set method = "both" or "bayesian".',
        )
    refuse_no_ratio(study.reference, why=NO_PLACE)
    asked = study.scene.inference
    observed = {
        (cell.parameter, cell.environment): cell.moments
        for cell in cell_moments(study.sessions, study.parameters, asked.family)
    }
    rows: list[dict[str, Any]] = []
    skipped = []
    for environment in study.environments:
        table = study.sessions.table
        others = study.over(
            dataclasses.replace(study.sessions, table=table[table["environment"] != environment])
        )
        given = {p: study.reference[p, environment] for p in study.parameters}
        try:
            found = predict(
                others,
                stiffness=given.get("k"),
                damping=given.get("b"),
                name=environment,
                kinds=("mean", "user"),
                curves=False,
            )
        except RefusalError as refused:
            skipped.append((environment, str(refused)))
            continue
        assert others.fit is not None
        laws = expected_users(others.fit, np.array(list(found.decades.values())), study.scene).laws
        rows += _against(found, laws, observed)
    return LeftOut(asked.family, asked.level, pd.DataFrame(rows), tuple(skipped))


def _against(
    found: Prediction, laws: ConditionalMoments, observed: dict[tuple[str, str], Moments | None]
) -> Iterator[dict[str, Any]]:
    limits = {(row["parameter"], row["kind"]): row for row in found.intervals.to_dict("records")}
    for p, (parameter, beyond) in enumerate(found.beyond.items()):
        mean, user = (limits[parameter, kind] for kind in ("mean", "user"))
        log = mean["family"] == "lognormal"
        known = observed[parameter, found.environment]
        if known is None:
            continue
        moments = known.on_scale(mean["family"])
        centre, sd, n = float(moments.mean), float(moments.sd), int(moments.n)
        reference = float(mean["reference"])
        response = centre - np.log(reference) if log else (centre - reference) / reference
        spread = np.hypot(laws.sd[:, p], laws.population_sd[:, p] / np.sqrt(n))
        ends = np.array([user["lower"], user["upper"]], dtype=float)
        held = np.diff(special.ndtr(((np.log(ends) if log else ends) - centre) / sd))
        value = float(np.exp(centre)) if log else centre
        yield {
            "environment": found.environment,
            "parameter": parameter,
            "reference": reference,
            "lower": float(mean["lower"]),
            "upper": float(mean["upper"]),
            "estimate": float(mean["estimate"]),
            "observed": value,
            "n": n,
            "inside": bool(mean["lower"] <= value <= mean["upper"]),
            "place": float(special.ndtr((response - laws.mean[:, p]) / spread).mean()),
            "user_lower": float(ends[0]),
            "user_upper": float(ends[1]),
            "users_inside": float(held[0]),
            "beyond": beyond,
        }
