"""A study as its reader sees it: wide and tidy tables, plots, the report, and a card in a notebook."""

from __future__ import annotations

import html
from collections.abc import Callable, Collection
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from percept.boundary.curves import Boundary
from percept.errors import counted
from percept.html import fields_html
from percept.results import (
    Band,
    ContrastRow,
    Coupling,
    Diagnostics,
    IntervalRow,
    Ladder,
    LeftOut,
    MethodPair,
    Passivity,
    Results,
    Sensitivity,
)
from percept.results import Skipped as SkippedResult
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.basics import Skipped, results, select
from percept.study.intervals import Row, normality_tests
from percept.study.results import (
    CLOSE_POINTS,
    admissible_couplings,
    boundaries_of,
    checks_of,
    data_of,
    provenance_of,
    record,
    rows,
    stable_edge,
)

_CELL = ["environment", "parameter", "kind"]
_LIMITS = ["estimate", "lower", "upper"]
_LABELS = ("environment", "kind", "method", "family", "joint", "shape", "level")
#: Joint treatments of close views: k and b each at the level asked for, or drawn together.
_CLOSE_JOINTS = ("marginal", "joint")
_CURVES = ("omega", "lower", "upper", "reference", "coupled")
#: What a study keeps once it is computed.
_KEPT = (
    "_intervals", "_fit", "_contrasts", "posterior", "checks", "regions", "boundaries", "band", "coupling",
    "coupling_design", "sensitivity", "ladder",
)  # fmt: skip
_CALLS = {
    "study.summary()": "both methods side by side",
    "study.plot_intervals()": "intervals over their references",
    "study.report(folder)": "the report: page, tables, figures",
    "study.skipped": "what is not computed, and why",
}


class StudyViews:
    """What `percept.Study` shows of its results.

    Every plot draws on the matplotlib axes `ax`, or on a new figure without them, and returns the
    axes. It raises UsageError for a name that the study does not have, RefusalError where there is
    nothing to plot.
    """

    sessions: Sessions
    scene: Scene
    progress: Any
    store: Any
    if TYPE_CHECKING:

        @property
        def intervals(self) -> pd.DataFrame:
            """Of `percept.Study`."""

        @property
        def parameters(self) -> tuple[str, ...]:
            """Of `percept.Study`."""

        @property
        def boundaries(self) -> tuple[Boundary, ...]:
            """Of `percept.Study`."""

    def summary(self, kind: str | None = "user") -> pd.DataFrame:
        """Lay the intervals out wide: a row per environment, parameter and kind, the methods side by side.

        Parameters
        ----------
        kind : {"user", "mean", "share"} or None
            Whose intervals; None for every kind the scene asks for. Another kind is a UsageError.

        Returns
        -------
        DataFrame
            `reference`, `unit`, `family`, and per method `METHOD_estimate`, `METHOD_lower` and
            `METHOD_upper` in that unit. The family is the scene's, or the other one where it has no
            interval. Limits hold for each parameter by itself.
        """
        intervals, asked = self.intervals, self.scene.inference
        kinds = select("kind", kind, asked.kinds)
        rows = intervals[(intervals["joint"] == "marginal") & intervals["kind"].isin(kinds)]
        own = rows["family"] == asked.family
        # Where the scene's family has no interval at all, the other one stands in.
        known = pd.MultiIndex.from_frame(rows[own][_CELL])
        rows = rows[own | ~pd.MultiIndex.from_frame(rows[_CELL]).isin(known)]
        table = rows.drop_duplicates(_CELL)[[*_CELL, "family", "unit", "reference"]]
        for method, found in rows.groupby("method", sort=False):
            named = found[[*_CELL, *_LIMITS]].rename(
                columns={name: f"{method}_{name}" for name in _LIMITS}
            )
            table = table.merge(named, on=_CELL, how="left")
        return table.reset_index(drop=True)

    @cached_property
    def _contrasts(self) -> list[Row | Skipped]:
        """Contrasts of the levels of a factor within subjects, and those there are none of."""
        if self.sessions.factor is None:
            return []
        from percept.study.contrasts import contrast_rows

        how = {"progress": self.progress, "store": self.store}
        return list(contrast_rows(self.sessions, self.parameters, self.scene, **how))

    @property
    def contrasts(self) -> pd.DataFrame:
        """Contrasts of the levels of `[study] factor`; empty without a factor.

        A row per pair of levels (`second` against `first`), reference, parameter, `of` (bias or
        spread), kind and method. Limits are ratios under the lognormal family; of bias under the
        normal one they are differences in references. `environment` is None for the average over
        `references`.
        """
        return pd.DataFrame(results(self._contrasts))

    @property
    def curves(self) -> pd.DataFrame:
        """The boundaries as one tidy table: a row per curve and frequency, rad/s and N·s/m."""
        names = (*_LABELS, *_CURVES)
        tables = [
            pd.DataFrame({name: getattr(one, name) for name in names}) for one in self.boundaries
        ]
        if not tables:
            return pd.DataFrame(columns=names)
        # Without a coupling its column is empty, and still of numbers.
        return pd.concat(tables, ignore_index=True).astype({"coupled": float})

    def results(
        self: Any,
        *,
        curves: bool = True,
        why: bool = False,
        progress: Callable[[str], None] | None = None,
    ) -> Results:
        """Compute everything that a report needs, and put it into records.

        Parameters
        ----------
        curves : bool
            Whether boundaries, the coupling judged by them and the band law are wanted; else they
            are absent.
        why : bool
            Whether the reasons why the methods differ are wanted; it samples the models between.
        progress : callable, optional
            Called with the name of each step.

        Returns
        -------
        percept.results.Results
            As report.json holds it.

        Raises
        ------
        PerceptError
            What the study refuses.
        """
        step = progress or _silent
        step("intervals")
        intervals = self.intervals.assign(covers=self.interpretation["covers"])
        step("contrasts")
        contrasts = self.contrasts
        step("boundaries")
        boundaries = self.boundaries if curves else ()
        drawn = {boundary.environment for boundary in boundaries}
        windows = {name: (low, high) for name, (low, high) in self.zoom.items() if name in drawn}
        asked = self.scene.inference
        close_kind = "user" if "user" in asked.kinds else asked.kinds[0]
        close: list[Boundary] = []
        for name, (low, high) in windows.items():
            omega = np.linspace(low, high, CLOSE_POINTS)
            close += self.boundaries_at(omega, (name,), kinds=(close_kind,), joints=_CLOSE_JOINTS)
        step("coupling")
        coupling = self.coupling if curves else None
        step("band law")
        band = self.band if curves else None
        step("admissible couplings")
        designs = self.coupling_design if boundaries and self.scene.coupling else {}
        edge = stable_edge(self.device, self.scene.device) if designs else None
        step("sensitivity to the device")
        sensitivity = self.sensitivity if curves else None
        step("comparison of methods")
        comparison, ladder = self.comparison, self.ladder if why else None
        step("checks of the model")
        checks = None
        if self.scene.checks is not None:
            checks = checks_of(normality_tests(self.sessions, self.parameters), self.checks)
        skipped = list(self.skipped if curves else self.skipped_before_curves)
        if not curves and len(intervals):
            skipped.append(Skipped("boundaries, coupling and band law", "run percept report"))
        return Results(
            provenance=provenance_of(self.sessions, self.scene),
            data=data_of(self.sessions, self.scene),
            intervals=rows(IntervalRow, intervals),
            contrast=rows(ContrastRow, contrasts),
            boundaries=boundaries_of(boundaries),
            zoom=windows,
            close=boundaries_of(close),
            passivity=rows(Passivity, self.passivity) if curves else None,
            coupling=record(Coupling, coupling),
            band=record(Band, band),
            design=admissible_couplings(designs, self.with_reference, asked.family, edge),
            sensitivity=record(Sensitivity, sensitivity),
            comparison=rows(MethodPair, comparison),
            ladder=record(Ladder, ladder),
            diagnostics=record(Diagnostics, self.diagnostics),
            checks=checks,
            skipped=tuple(SkippedResult(what, why_not) for what, why_not in skipped),
        )

    def report(self: Any, directory: str | Path, **options: Any) -> Path:
        """Write page, JSON, tables, figures and posterior into a folder, and return the page's path.

        The folder is made where it does not exist. UsageError where it cannot be written, or where
        a file that no earlier run wrote has one of the report's names: before anything is computed.
        Options are those of `percept.report.report_folder` and `percept.report.fill_report`, such as
        ``formats=("pdf",)``, and `why` of `results`.
        """
        # Matplotlib is slow to import.
        from percept.report import fill_report, report_folder

        formats = options.pop("formats", ("svg",))
        of_folder = {name: options.pop(name) for name in ("force", "say") if name in options}
        why, progress = options.pop("why", False), options.get("progress")
        with report_folder(directory, formats=formats, **of_folder) as folder:
            results = self.results(why=why, progress=progress)
            fill_report(folder, results, posterior=self.posterior, formats=formats, **options)
        return Path(directory) / "report.html"

    def plot_intervals(
        self: Any,
        parameter: str | None = None,
        *,
        kinds: Collection[str] | None = None,
        ax: Any = None,
    ) -> Any:
        """Plot intervals divided by their references: of every parameter and kind, or of those named."""
        from percept.plots import plot_intervals

        intervals = self.intervals.assign(covers=self.interpretation["covers"])
        return plot_intervals(
            rows(IntervalRow, intervals),
            data_of(self.sessions, self.scene),
            parameters=select("parameter", parameter, self.parameters),
            kinds=select("kind", kinds, self.scene.inference.kinds),
            family=self.scene.inference.family,
            ax=ax,
        )

    def plot_boundary(
        self: Any, environment: str, *, kind: str | None = None, ax: Any = None
    ) -> Any:
        """Plot boundaries of abs(Z_h), N·s/m, over omega, rad/s, for one kind: the next user by default."""
        from percept.plots import plot_boundary

        kinds = self.scene.inference.kinds
        (kind,) = select("kind", kind or ("user" if "user" in kinds else kinds[0]), kinds)
        boundaries = boundaries_of(self.boundaries)
        if boundaries:
            (environment,) = select("environment", environment, self.with_reference)
        return plot_boundary(
            boundaries, environment, kind, family=self.scene.inference.family, ax=ax
        )

    def plot_band(self: Any, parameter: str | None = None, *, ax: Any = None) -> Any:
        """Plot bands and their laws against the environment's impedance, or a parameter's reference."""
        from percept.plots import plot_band

        band = record(Band, self.band)
        data = data_of(self.sessions, self.scene)
        return plot_band(band, data, parameter, family=self.scene.inference.family, ax=ax)

    def plot_coupling(self: Any, *, ax: Any = None) -> Any:
        """Plot the stability criterion of the coupling (Eq. 10) over omega, rad/s."""
        from percept.plots import plot_coupling

        return plot_coupling(record(Coupling, self.coupling), ax=ax)

    def plot_check(self: Any, *, ax: Any = None) -> Any:
        """Plot how far each subject lies from what the others predict.

        In a model that holds, the probabilities of lying as far off are uniform. The shaded band
        holds each ordered probability of independent subjects with probability 0.99.
        """
        from percept.plots import plot_check

        loo = None if self.checks is None else record(LeftOut, self.checks.loo)
        return plot_check(None if loo is None else loo.subjects, ax=ax)

    def __repr__(self) -> str:
        adjusted = " and ".join(self.sessions.parameters)
        where = counted(len(self.sessions.environments), "environment")
        return f"<Study of {adjusted} in {where}, {self.sessions.form}>"

    def _repr_html_(self) -> str:
        """Return a card: what the study is, what it has computed, and what to call; it computes nothing."""
        sessions, asked = self.sessions, self.scene.inference
        computed = [name.lstrip("_") for name in _KEPT if name in vars(self)]
        about = {
            "quantities": ", ".join(
                sessions.quantities[name].words for name in sessions.parameters
            ),
            "environments": len(sessions.environments),
            "subjects": len(sessions.subjects) or "published limits",
            "method": f"{asked.method}, {asked.family}, level {asked.level:g}",
            "device": "none" if self.scene.device is None else "yes",
            "coupling": "none" if self.scene.coupling is None else "yes",
            "computed": ", ".join(computed) or "nothing yet",
        }
        calls = "".join(
            f"<li><code>{html.escape(call)}</code>: {what}</li>" for call, what in _CALLS.items()
        )
        return f"{fields_html(about, caption='Study')}<ul>{calls}</ul>"


def _silent(step: str) -> None:
    """Tell nobody of a step."""
