"""The parts of a study, each computed when it is first read, with what is skipped and why."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection
from functools import cached_property
from typing import TYPE_CHECKING, Any

import pandas as pd
from numpy.typing import ArrayLike

from percept import haptics
from percept.boundary.band import BandStudy
from percept.boundary.users import Users
from percept.haptics.records import AnyDevice
from percept.results import (
    AdmissibleCouplings,
    BandPair,
    Boundary,
    Checks,
    Coupling,
    IntervalRow,
    OtherDevices,
    Rendered,
    Verdict,
)
from percept.results.fields import Family, Method
from percept.scene import Scene
from percept.sessions import Sessions
from percept.sessions.quantities import is_impedance
from percept.study.anova import ByLevel, by_level
from percept.study.band import Banded, band_study, with_band
from percept.study.basics import FAMILIES, Skipped, analysed_parameters, referenced, results, select
from percept.study.boundaries import JOINTS, BoundaryDrawing, increasing, zoom_windows
from percept.study.coupling_map import coupling_map, no_coupling_map
from percept.study.device import Setup, device_of, setup_of, study_coupling
from percept.study.intervals import (
    COLUMNS,
    Cell,
    Row,
    cell_moments,
    classical_rows,
    compare_intervals,
)
from percept.study.other_devices import no_other_devices, other_devices
from percept.study.psychophysics import Psychophysics
from percept.study.regions import Law, Region, SubjectPairs, laws_of, regions_of, subject_pairs
from percept.study.rendering import study_rendering
from percept.study.responses import references, refuse_lone_subject
from percept.study.verdicts import (
    Subjects,
    leaning_on_slips,
    likely_users,
    posterior_users,
    study_verdicts,
    subjects_of,
)

__all__ = ["Parts"]

# What imports the hierarchical model is imported where needed: the classical method does without.
if TYPE_CHECKING:
    from xarray import DataTree

    from percept.inference.sampling.gate import Progress
    from percept.study.fit import Fit, RunStore
    from percept.study.ladder import Ladder


class Parts:
    """What `Study` computes, and why it skips the rest.

    Parameters
    ----------
    sessions : Sessions
        With the levels of the scene's factor, where it names one.
    scene : Scene
        What to analyse.
    progress : callable or None
        Told the state of the sampler after every round.
    store : RunStore or None
        Where finished runs of the sampler are kept.
    """

    def __init__(
        self,
        sessions: Sessions,
        scene: Scene,
        progress: Callable[[Progress], None] | None,
        store: RunStore | None,
    ) -> None:
        self.sessions = sessions
        self.scene = scene
        self.progress = progress
        self.store = store

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Parameters analysed: those the scene names, or all that were adjusted."""
        asked = self.scene.inference.parameters
        return analysed_parameters(self.sessions.parameters, asked, self.sessions.quantities)

    @property
    def environments(self) -> tuple[str, ...]:
        """Environments as the scene lists them, then by their references."""
        return self.sessions.environments

    @cached_property
    def reference(self) -> dict[tuple[str, str], float]:
        """Reference per (parameter, environment), in the parameter's unit."""
        values = references(self.sessions, self.parameters, self.environments).ravel().tolist()
        return dict(zip(itertools.product(self.parameters, self.environments), values, strict=True))

    @cached_property
    def interval_rows(self) -> list[IntervalRow | Skipped]:
        """Rows of the interval table, and the intervals there are none of."""
        asked = self.scene.inference
        rows: list[IntervalRow | Skipped] = []
        if asked.method != "bayesian":
            if self.sessions.form == "trials":
                refuse_lone_subject(self.sessions.subjects)
            rows += classical_rows(self.cells, asked, self.reference, users=self.scene.user_noun)
        if self._fit is None:
            return rows
        if isinstance(self._fit, Skipped):
            return [*rows, self._fit]
        from percept.study.fit import bayesian_rows

        return [*rows, *bayesian_rows(self._fit, asked, self.reference, self.scene.user_noun)]

    @cached_property
    def psychophysics(self) -> Psychophysics:
        """Points of equality, thresholds, spreads, reliability; biases against one JND."""
        cells = self.cells[self.scene.inference.family]
        return Psychophysics(self.sessions, self.scene, cells, self.reference, self.passed)

    @property
    def intervals(self) -> pd.DataFrame:
        """Intervals of every method, kind and family; a copy."""
        return pd.DataFrame(results(self.interval_rows), columns=COLUMNS)

    @cached_property
    def contrast_rows(self) -> list[Row | Skipped]:
        """Contrasts of the model's terms, and those there are none of."""
        if not self.scene.terms:
            return []
        from percept.study.contrasts import contrast_rows

        return list(contrast_rows(self.sessions, self.parameters, self.scene, self.passed))

    @cached_property
    def by_level(self) -> ByLevel:
        """Subjects' means at the levels of factors, and their analysis of variance."""
        return by_level(self.sessions, self.scene, self.parameters)

    @property
    def contrasts(self) -> pd.DataFrame:
        """Contrasts as `Study.contrast` gives them, of all terms; empty without one."""
        return pd.DataFrame(results(self.contrast_rows))

    @cached_property
    def cells(self) -> dict[Family, list[Cell]]:
        """Cells of each family."""
        return {family: cell_moments(self.sessions, self.parameters, family) for family in FAMILIES}

    @cached_property
    def _fit(self) -> Fit | Skipped | None:
        if self.scene.inference.method == "classical":
            return None
        from percept.study.fit import fitted
        from percept.study.prepare import prepared_beside

        prepared = prepared_beside(self.cells, self.sessions, self.scene, self.parameters)
        if isinstance(prepared, Skipped):
            return prepared
        return fitted(prepared, self.scene.inference, progress=self.progress, store=self.store)

    @property
    def fit(self) -> Fit | None:
        """The sampled hierarchical model; None where not asked for, or beyond the data."""
        return None if isinstance(self._fit, Skipped) else self._fit

    @property
    def passed(self) -> Fit | None:
        """The fit, where the gate has passed it."""
        return self.fit if self.fit and self.fit.passed else None

    @cached_property
    def posterior(self) -> DataTree | None:
        """Posterior as an ArviZ DataTree, thinned to the effective size; None unless it passed."""
        if self.passed is None:
            return None
        from percept.study.posterior import posterior_tree

        return posterior_tree(self.passed, seed=self.scene.inference.seed)

    @property
    def checks(self) -> Checks | None:
        """Checks of the hierarchical model; None without a passed fit that pools sessions."""
        return None if isinstance(self._checked, Skipped) else self._checked

    @cached_property
    def _checked(self) -> Checks | Skipped | None:
        if self.passed is None:
            return None
        if isinstance(self.passed.subjects, Skipped):
            return self.passed.subjects
        from percept.study.checks import model_checks

        asked = self.scene.inference
        return model_checks(
            self.passed,
            self.passed.subjects,
            level=asked.level,
            seed=asked.seed,
        )

    @cached_property
    def device(self) -> AnyDevice | None:
        """The scene's device; None without one."""
        return device_of(self.scene)

    @property
    def within(self) -> tuple[float, float]:
        """Ends of the frequencies that everything is judged over, rad/s."""
        return self.scene.frequency.lower, self.scene.frequency.upper

    @cached_property
    def _with_reference(self) -> list[str | Skipped]:
        quantities = self.sessions.quantities
        if not is_impedance(self.parameters):
            if self.device is None or not is_impedance(quantities):
                return []
            why = f"only {quantities[self.parameters[0]].label} was adjusted"
            return [Skipped("boundaries", why)]
        whole = self.reference, self.parameters, self.environments, quantities
        return list(referenced(*whole))

    @property
    def with_reference(self) -> tuple[str, ...]:
        """Environments with a reference of stiffness and damping, which curves are drawn for."""
        return tuple(results(self._with_reference))

    @cached_property
    def _setup(self) -> list[Setup | Skipped]:
        shown = {
            e: haptics.Environment(
                self.reference["k", e], self.reference["b", e], self.sessions.masses[e]
            )
            for e in self.with_reference
        }
        return list(setup_of(self.scene, self.device, shown))

    @property
    def setup(self) -> Setup | None:
        """Device, coupling and references of curves; None without device or reference."""
        return next((one for one in results(self._setup) if one.references), None)

    @cached_property
    def boundaries(self) -> tuple[Boundary, ...]:
        """Boundaries of abs(Z_h) over the scene's frequencies; empty without device, k or b."""
        return self.boundaries_at(None)

    def boundaries_at(
        self,
        omega: ArrayLike | None,
        environments: Collection[str] | None = None,
        *,
        kinds: Collection[str] | None = None,
        joints: Collection[str] | None = None,
    ) -> tuple[Boundary, ...]:
        """Boundaries as `Study.boundaries_at` gives them."""
        grid = None if omega is None else increasing(omega)
        environments = select("environment", environments, self.with_reference)
        kinds = select("kind", kinds, self.scene.inference.kinds)
        joints = select("joint treatment", joints, JOINTS)
        if self._drawing is None:
            return ()
        return self._drawing.at(grid, environments, kinds, joints)

    @cached_property
    def _drawing(self) -> BoundaryDrawing | None:
        if self.setup is None:
            return None
        table = self.scene.frequency
        tolerance = self.scene.inference.tolerance
        return BoundaryDrawing(self.setup, self.regions, self.curve_laws, table, tolerance)

    @cached_property
    def _zoom(self) -> list[tuple[str, list[float]] | Skipped]:
        return list(zoom_windows(self.scene, self.environments if self.with_reference else ()))

    @property
    def zoom(self) -> dict[str, list[float]]:
        """Window of omega, rad/s, that each environment's close view shows."""
        return dict(results(self._zoom))

    @cached_property
    def _pairs(self) -> list[SubjectPairs | Skipped]:
        return list(subject_pairs(self.sessions, self.scene, self.parameters))

    @cached_property
    def curve_laws(self) -> tuple[Law, ...]:
        """Laws of (k, b) of the average and the next user; empty where no correlation is known."""
        return laws_of(results(self._pairs), self.passed, self.scene.inference)

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Rectangles and ellipses of (k, b) of every method, kind and joint treatment."""
        return regions_of(self.intervals, self.curve_laws, self.passed, self.scene.inference)

    @cached_property
    def _banded(self) -> list[Banded | Skipped]:
        """What bands are set against: environments' impedance, or quantities' references.

        A band is of users; without their intervals there is none.
        """
        if "user" not in self.scene.inference.kinds:
            return []
        names = self.with_reference if is_impedance(self.parameters) else self.environments
        read_at = self.scene.frequency.read_at
        return list(with_band(self.reference, self.parameters, names, read_at))

    @cached_property
    def band(self) -> BandStudy | None:
        """Band of the environments' size and its law; None with one environment, or no size."""
        banded = results(self._banded)
        if not banded or len(self.environments) < 2:
            return None
        return band_study(self.intervals, banded, self.cells, self.passed, self.scene.inference)

    @cached_property
    def coupling(self) -> Coupling | None:
        """The coupling by the paper, Eq. 10 and its rule; None without device and coupling."""
        setup = next(iter(results(self._setup)), None)
        if setup is None or setup.coupling is None:
            return None
        read_at = self.scene.frequency.read_at
        family = self.scene.inference.family
        return study_coupling(setup, self.regions, self.within, family=family, read_at=read_at)

    @cached_property
    def rendering(self) -> tuple[Rendered, ...]:
        """What the device renders with every passive hand; empty without a device."""
        return () if self.setup is None else study_rendering(self.setup)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether each environment feels real, directly and coupled; empty without a device."""
        if self.setup is None:
            return ()
        stable = {(row.environment, row.coupled): row.stable for row in self.rendering}
        judged = study_verdicts(self.setup, self.users, self.subjects, self.scene, stable=stable)
        if not self.sessions.slips:
            return tuple(judged)
        return tuple(leaning_on_slips(judged, self.sessions, self._verdicts_over))

    def _verdicts_over(self, sessions: Sessions) -> tuple[Verdict, ...]:
        """Verdicts of the same scene over other sessions."""
        return Parts(sessions, self.scene, self.progress, self.store).verdicts

    @cached_property
    def users(self) -> dict[str, Users]:
        """Posterior draws of the population of users by environment; empty without a passed fit."""
        if self.passed is None or self.setup is None:
            return {}
        return posterior_users(self.passed, self.scene.inference)

    @cached_property
    def subjects(self) -> dict[str, Subjects]:
        """What the classical method knows of the users of each environment."""
        return subjects_of(self.cells, results(self._pairs), self.scene.inference)

    @cached_property
    def map_users(self) -> dict[str, Users]:
        """Draws of users behind maps: posterior ones, else fiducial ones of subjects."""
        if self.users or self.setup is None or self.scene.inference.method == "bayesian":
            return self.users
        return likely_users(self.subjects, self.setup, self.scene.inference)

    @property
    def map_method(self) -> Method:
        """Whose draws the maps are made from."""
        return "bayesian" if self.users else "classical"

    @cached_property
    def coupling_map(self) -> AdmissibleCouplings | None:
        """How probably stable couplings feel real, and the ends of those that do."""
        if self.setup is None:
            return None
        whose = self.map_users, self.map_method
        return coupling_map(self.setup, *whose, self.scene, self.within)

    @cached_property
    def other_devices(self) -> OtherDevices | None:
        """How verdicts move with the device's mass and damping; None without both."""
        if self.setup is None:
            return None
        whose = self.map_users, self.map_method
        return other_devices(self.setup, *whose, self.scene, self.within)

    @property
    def comparison(self) -> pd.DataFrame | None:
        """The methods' intervals in equal family and kind; a copy, None without both methods."""
        both = self.passed is not None and self.scene.inference.method == "both"
        return compare_intervals(self.intervals) if both else None

    @cached_property
    def band_pairs(self) -> tuple[BandPair, ...] | None:
        """How the methods' boundaries differ; None without both methods, and without a device."""
        if self.comparison is None or self.passed is None or self._drawing is None:
            return None
        from percept.study.ladder import band_pairs

        return band_pairs(self.passed, self._drawing, self.regions, self.scene.inference)

    @cached_property
    def ladder(self) -> Ladder | None:
        """Why the methods differ, by steps that are sampled; None without both methods."""
        if self.passed is None or self.scene.inference.method != "both":
            return None
        from percept.study.ladder import climb

        whole = self.sessions, self.scene, self.parameters, self.intervals, self.passed
        return climb(*whole, progress=self.progress, store=self.store)

    @property
    def skipped(self) -> tuple[Skipped, ...]:
        """What was not computed, and why."""
        curves = self._drawing.skipped if self._drawing is not None else []
        return (*self.skipped_before_curves, *curves)

    @cached_property
    def skipped_before_curves(self) -> tuple[Skipped, ...]:
        """What was not computed, and why, curves of laws not counted: they take time to draw."""
        skipped: list[Any] = [*self.interval_rows, *self._with_reference, *self._setup, *self._zoom]
        skipped += [*self.contrast_rows, *self.by_level.tests, *self._banded, *self._pairs]
        skipped += self.psychophysics.skipped
        if self.setup is not None:
            skipped.append(no_other_devices(self.setup, self.map_users))
            if self.setup.coupling is not None:
                skipped.append(no_coupling_map(self.setup, self.map_users))
        if self.scene.checks is not None:
            skipped.append(self._checked)
        return tuple(dict.fromkeys(part for part in skipped if isinstance(part, Skipped)))
