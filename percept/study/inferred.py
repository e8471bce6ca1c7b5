"""What a study infers from its sessions: the fit, intervals, contrasts, psychophysics."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Iterator
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pandas as pd

from percept.results import (
    AnovaRow,
    Checks,
    ContrastRow,
    EquivalenceRow,
    IntervalRow,
    Ladder,
    LevelValues,
    MethodPair,
    PsychophysicsRow,
    Skipped,
)
from percept.scene import Scene
from percept.sessions import Sessions
from percept.study.contrasts import (
    anova_rows,
    classical_contrasts,
    level_values,
    posterior_contrasts,
)
from percept.study.data import Data
from percept.study.equivalence import classical_equivalence, posterior_equivalence
from percept.study.intervals import COLUMNS, bayesian_rows, classical_rows, method_pairs
from percept.study.psychophysics import (
    absent_jnds,
    classical_psychophysics,
    posterior_psychophysics,
)
from percept.study.responses import refuse_lone_subject

# What imports the hierarchical model is imported where it is needed: the classical method does
# without.
if TYPE_CHECKING:
    from xarray import DataTree

    from percept.inference.sampling.gate import Progress
    from percept.study.fit import Fit, RunStore
    from percept.study.prepare import Prepared


T = TypeVar("T")


def part(found: Callable[[Any], Iterable[T | Skipped]]) -> cached_property[tuple[T, ...]]:
    """Keep what a method yields as a part of a study, and note what it skips under its name."""

    @wraps(found)
    def kept(study: Inferred) -> tuple[T, ...]:
        rows = []
        study.skipped_by_part[found.__name__] = []
        for one in found(study):
            if isinstance(one, Skipped):
                study.skipped_by_part[found.__name__].append(one)
            else:
                rows.append(one)
        return tuple(rows)

    return cached_property(kept)


class Inferred:
    """Parts of a study that rest on its sessions alone, each computed when it is first read.

    Parameters
    ----------
    data : Data
        Sessions under a scene.
    progress : callable or None
        Told the state of the sampler as it runs.
    store : RunStore or None
        Where finished runs of the sampler are kept.
    """

    def __init__(
        self,
        data: Data,
        progress: Callable[[Progress], None] | None,
        store: RunStore | None,
    ) -> None:
        self.data = data
        self.progress = progress
        self.store = store
        #: What is noted when a part is computed, by its name.
        self.skipped_by_part: dict[str, list[Skipped]] = {}

    @property
    def sessions(self) -> Sessions:
        """The sessions, their environments told apart by the levels of the scene's factors."""
        return self.data.sessions

    @property
    def scene(self) -> Scene:
        """What is analysed."""
        return self.data.scene

    def skipped_of(self, *parts: str) -> tuple[Skipped, ...]:
        """Return what some parts skip, and why."""
        found: list[Skipped] = []
        for name in parts:
            getattr(self, name)
            found += self.skipped_by_part.get(name, [])
        return tuple(dict.fromkeys(found))

    def _by_methods(
        self, classical: Callable[[Data], Iterable[T]], posterior: Callable[[Fit], Iterable[T]]
    ) -> Iterator[T]:
        """Yield what the methods say that are asked for, the Bayesian one of a fit that passed."""
        if self.data.asked.method != "bayesian":
            yield from classical(self.data)
        if self.passed is not None:
            yield from posterior(self.passed)

    @part
    def interval_rows(self) -> Iterator[IntervalRow | Skipped]:
        """Intervals of every method, kind and family."""
        if self.data.asked.method != "bayesian":
            if self.sessions.form == "trials":
                refuse_lone_subject(self.sessions.subjects)
            yield from classical_rows(self.data)
        fit = self.fit
        if fit is None:
            return
        yield from fit.skipped
        if not fit.passed:
            yield Skipped("Bayesian intervals", fit.withheld)
            return
        cells = fit.model.cells
        references = [self.data.reference[cell] for cell in cells]
        for kind in self.data.asked.kinds:
            ends = np.stack([*fit.limits[kind], fit.estimate])
            yield from bayesian_rows(fit, kind, cells, ends, references, fit.counts.tolist())

    @property
    def intervals(self) -> pd.DataFrame:
        """Intervals of every method, kind and family, one row each, in their units; a copy."""
        table = pd.DataFrame(self.interval_rows, columns=COLUMNS)
        return table.astype({"reference": float})

    @property
    def comparison(self) -> tuple[MethodPair, ...] | None:
        """The methods' intervals in equal family and kind; None without both methods."""
        if self.passed is None or self.data.asked.method != "both":
            return None
        return tuple(method_pairs(self.interval_rows))

    @part
    def psychophysics_rows(self) -> Iterator[PsychophysicsRow | Skipped]:
        """Points of equality, thresholds, spreads and reliability, in the scene's family."""
        yield from absent_jnds(self.data)
        yield from self._by_methods(classical_psychophysics, posterior_psychophysics)

    @property
    def psychophysics(self) -> pd.DataFrame:
        """Points of equality, thresholds, spreads and reliability, one row each."""
        return pd.DataFrame(self.psychophysics_rows)

    @part
    def equivalence_rows(self) -> Iterator[EquivalenceRow | Skipped]:
        """Whether biases are smaller than one JND; empty without a JND."""
        return self._by_methods(classical_equivalence, posterior_equivalence)

    @property
    def equivalence(self) -> pd.DataFrame:
        """Whether each bias is smaller than the JND of `[study] jnd`; empty without one."""
        return pd.DataFrame(self.equivalence_rows)

    @part
    def contrast_rows(self) -> Iterator[ContrastRow | Skipped]:
        """Contrasts of the model's terms; empty without factors and covariates."""
        return self._by_methods(classical_contrasts, posterior_contrasts)

    @property
    def contrasts(self) -> pd.DataFrame:
        """Contrasts of all terms; empty without one.

        A row per pair of levels (`second` against `first`), reference, parameter, `of` (bias,
        spread, precision, interaction, level or slope), kind and method. Limits are ratios under
        the lognormal family; of bias under the normal one they are differences in `unit`.
        `environment` is None for the average over `references`.
        """
        return pd.DataFrame(self.contrast_rows)

    @cached_property
    def levels(self) -> tuple[LevelValues, ...]:
        """What the subjects set at every level of the factors."""
        return tuple(level_values(self.data))

    @part
    def anova(self) -> Iterator[AnovaRow | Skipped]:
        """The analysis of variance of the model's terms."""
        return anova_rows(self.data)

    @part
    def prepared(self) -> Iterator[Prepared | Skipped]:
        """The hierarchical model; empty where not asked for, or beyond the data."""
        if self.data.asked.method != "classical":
            from percept.study.prepare import prepared_beside

            yield prepared_beside(self.data)

    @cached_property
    def fit(self) -> Fit | None:
        """The sampled hierarchical model; None where not asked for, or beyond the data."""
        if not self.prepared:
            return None
        from percept.study.fit import fitted

        return fitted(self.prepared[0], progress=self.progress, store=self.store)

    @property
    def passed(self) -> Fit | None:
        """The fit, where the gate has passed it."""
        return self.fit if self.fit and self.fit.passed else None

    @cached_property
    def posterior(self) -> DataTree | None:
        """Posterior as an ArviZ DataTree, thinned to the effective size; None unless it passed."""
        file = self.posterior_file()
        if file is None:
            return None
        # Slow to import, and of no use to a study that is only saved.
        import xarray

        return xarray.open_datatree(io.BytesIO(file), engine="h5netcdf").load()

    def posterior_file(self) -> bytes | None:
        """Return `posterior` as a netCDF file; None unless the fit passed."""
        if self.passed is None:
            return None
        from percept.study.posterior import netcdf

        return netcdf(self.passed)

    @part
    def _checked(self) -> Iterator[Checks | Skipped]:
        """Checks of a passed fit that pools sessions, where the scene asks for them."""
        if self.scene.checks is not None and self.passed is not None:
            from percept.study.checks import model_checks

            yield model_checks(self.passed)

    @property
    def checks(self) -> Checks | None:
        """Tests of normality, and checks of a passed fit that pools sessions.

        None where the scene does not ask for checks, and without sessions.
        """
        normality = self.data.normality if self.scene.checks is not None else ()
        alone = Checks(normality=normality) if normality else None
        return next(iter(self._checked), alone)

    @cached_property
    def ladder(self) -> Ladder | None:
        """Why the methods differ, by steps that are sampled; None without both methods."""
        if self.passed is None or self.data.asked.method != "both":
            return None
        from percept.study.ladder import climb

        how = {"progress": self.progress, "store": self.store}
        return climb(self.interval_rows, self.passed, **how)
