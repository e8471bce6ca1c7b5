"""What a study says of its device: curves, the coupling, what is rendered and what feels real."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property

import pandas as pd

from percept import haptics
from percept.boundary.confidence import Subjects
from percept.boundary.shares import Users
from percept.errors import RefusalError, counted
from percept.haptics.records import AnyDevice
from percept.inference.record import Method
from percept.results import (
    MOST_SHOWN,
    AdmissibleCouplings,
    Band,
    BandPair,
    Boundary,
    Coupling,
    OtherDevices,
    Rendered,
    Skipped,
    Verdict,
    ZWidth,
)
from percept.study.band import Banded, band_study, with_band
from percept.study.basics import Array, select
from percept.study.boundaries import BoundaryDrawing, band_pairs, envelopes
from percept.study.data import Data
from percept.study.device import Setup, device_of, referenced, setup_of, study_coupling
from percept.study.inferred import Inferred, part
from percept.study.maps import coupling_map, no_coupling_map, no_other_devices, other_devices
from percept.study.regions import (
    Drawn,
    Law,
    Region,
    SubjectPairs,
    laws_of,
    of_family,
    rectangles,
    subject_pairs,
    widened,
)
from percept.study.rendering import study_rendering, z_width
from percept.study.verdicts import (
    MapUsers,
    leaning_on_slips,
    posterior_users,
    study_verdicts,
    subjects_of,
    verdict_table,
)

#: Of a fit without rows that look mistyped: verdicts need its draws, and no accurate limits.
_TOLERANCE = 0.05
_LABELS = ("environment", "kind", "method", "family", "joint", "shape", "level")
_CURVES = ("omega", "lower", "upper", "reference", "coupled")


class Displayed(Inferred):
    """Parts of a study that need its device, or stiffness and damping together."""

    @cached_property
    def device(self) -> AnyDevice | None:
        """The scene's device; None without one."""
        return device_of(self.scene)

    @part
    def with_reference(self) -> Iterator[str | Skipped]:
        """Environments with a reference of stiffness and damping, which curves are drawn for."""
        return referenced(self.data)

    @property
    def _shown(self) -> tuple[str, ...]:
        """Environments with curves and maps in results."""
        return self.with_reference[:MOST_SHOWN]

    @property
    def setup(self) -> Setup | None:
        """Device, coupling and references of curves; None without device or reference."""
        return next((setup for setup in self._setups if setup.references), None)

    @part
    def _setups(self) -> Iterator[Setup | Skipped]:
        """The same, also where no environment has a reference of both quantities; one at most."""
        shown = {}
        for name in self.with_reference:
            stiffness, damping = (self.data.reference[p, name] for p in ("k", "b"))
            shown[name] = haptics.Environment(stiffness, damping, self.sessions.masses[name])
        return setup_of(self.scene, self.device, shown)

    @part
    def pairs(self) -> Iterator[SubjectPairs | Skipped]:
        """Stiffness and damping of each subject, by environment and family."""
        return subject_pairs(self.data)

    @cached_property
    def curve_laws(self) -> tuple[Law, ...]:
        """Laws of (k, b) of the average and the next user; empty where no correlation is known."""
        return self._laws_of(self._shown)

    def _laws_of(self, environments: Collection[str]) -> tuple[Law, ...]:
        pairs = self._drawn(self.pairs)
        return tuple(laws_of(pairs, self.passed, self.data.asked, environments))

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Rectangles and ellipses of (k, b) of every method, kind and joint treatment."""
        return self._regions_of(self.curve_laws, self._shown)

    def _regions_of(self, laws: Sequence[Law], environments: Collection[str]) -> tuple[Region, ...]:
        found = [*self._rectangles]
        if self.passed is not None:
            found += widened(self.passed, self.data.asked, environments)
        return (*found, *(law.region for law in laws if law.region))

    @cached_property
    def _rectangles(self) -> Sequence[Region]:
        """Rectangles of (k, b) of the intervals."""
        return self._drawn(rectangles(self.interval_rows))

    def _drawn(self, claims: Iterable[Drawn]) -> Sequence[Drawn]:
        """Leave out what is not of the scene's family, unless the scene asks for all curves."""
        if self.scene.report.curves == "all":
            return tuple(claims)
        return of_family(claims, self.data.asked.family)

    @part
    def boundaries(self) -> Iterator[Boundary | Skipped]:
        """Boundaries of abs(Z_h) over the scene's frequencies; empty without device, k or b.

        Of many environments they are of the first, as maps are; `boundaries_of` draws any.
        """
        return self._curves_of(self._shown)

    def boundaries_of(self, environments: Collection[str] | None = None) -> tuple[Boundary, ...]:
        """Boundaries of all environments, or of those named."""
        names = select("environment", environments, self.with_reference)
        return tuple(one for one in self._curves_of(names) if isinstance(one, Boundary))

    def _curves_of(self, environments: Collection[str]) -> Iterator[Boundary | Skipped]:
        if self.setup is not None:
            laws = self._laws_of(environments)
            regions = self._regions_of(laws, environments)
            tolerance = self.data.asked.tolerance
            drawing = BoundaryDrawing(self.setup, regions, laws, self.scene.frequency, tolerance)
            yield from drawing.drawn(environments)

    def envelopes_at(self, omega: Array) -> tuple[Boundary, ...]:
        """Exact envelopes at frequencies (M,), rad/s, of k and b each at its level."""
        return () if self.setup is None else tuple(envelopes(self.setup, self._rectangles, omega))

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

    @part
    def banded(self) -> Iterator[Banded | Skipped]:
        """What bands are set against: environments' impedance, or quantities' references."""
        names = self.with_reference if self.data.is_impedance else self.data.environments
        return with_band(self.data, names)

    @cached_property
    def band(self) -> Band | None:
        """Band of the environments' size and its law; None with one environment, or no size."""
        if not self.banded or len(self.data.environments) < 2:
            return None
        return band_study(self.interval_rows, self.banded, self.data, self.passed)

    @cached_property
    def band_pairs(self) -> tuple[BandPair, ...] | None:
        """How the methods' boundaries differ; None without both methods, and without a device."""
        if self.comparison is None or self.setup is None:
            return None
        classical, bayesian = (
            [one for one in self.boundaries if one.method == method]
            for method in ("classical", "bayesian")
        )
        return tuple(band_pairs(classical, bayesian, "environment", "kind", "family"))

    @cached_property
    def coupling_row(self) -> Coupling | None:
        """The coupling by the paper, Eq. 10 and its rule; None without device and coupling."""
        setup = next(iter(self._setups), None)
        if setup is None or setup.coupling is None:
            return None
        return study_coupling(setup, self._rectangles, self.data.asked.family, self.scene.frequency)

    @cached_property
    def rendering(self) -> tuple[Rendered, ...]:
        """What the device renders with every passive hand, in time; empty without a device."""
        return () if self.setup is None else study_rendering(self.setup)

    @property
    def zwidth(self) -> ZWidth | None:
        """The edge of what the device renders with every passive hand; None without a device."""
        setup = self.setup
        return None if setup is None else z_width(setup.loop, setup.references, setup.draws)

    @cached_property
    def users(self) -> dict[str, Users]:
        """Posterior draws of the population of users by environment; empty without a passed fit."""
        if self.passed is None or self.setup is None:
            return {}
        return posterior_users(self.passed)

    @cached_property
    def subjects(self) -> dict[str, Subjects]:
        """What the classical method knows of the users of each environment."""
        return subjects_of(self.data, self.pairs)

    @cached_property
    def map_users(self) -> MapUsers:
        """Draws of users behind maps: posterior ones, else fiducial ones of subjects."""
        users = self.users
        method: Method = "bayesian"
        if not users and self.data.asked.method != "bayesian":
            method = "classical"
            users = {name: known.users for name, known in self.subjects.items() if known.users}
        return MapUsers({name: users[name] for name in self._shown if name in users}, method)

    @cached_property
    def verdict_rows(self) -> tuple[Verdict, ...]:
        """Whether each environment feels real, directly and coupled; empty without a device."""
        if self.setup is None:
            return ()
        stable = {(row.environment, row.coupled): row.stable for row in self.rendering}
        weights: dict[str, Array] = {}
        if self.scene.checks is not None and self.passed is not None:
            from percept.study.checks import weights_without

            weights = weights_without(self.passed, self.map_users.draws)
        judged = study_verdicts(
            self.setup, self.users, self.subjects, self.scene, stable=stable, weights=weights
        )
        # A page names no more rows; more of them are scatter, and cost a fit of their own.
        if not 0 < len(self.sessions.slips) <= MOST_SHOWN:
            return tuple(judged)
        return tuple(leaning_on_slips(judged, self.sessions, self._without_slips))

    @property
    def verdicts(self) -> pd.DataFrame:
        """What can be rendered and feels real: a row per environment, display and method."""
        return verdict_table(self.verdict_rows, self.rendering)

    @cached_property
    def _without_slips(self) -> tuple[Verdict, ...]:
        """Verdicts without the rows that look mistyped; empty where the rest carries none."""
        doubted = {slip.row for slip in self.sessions.slips}
        kept = self.sessions.table.drop(index=list(doubted))
        sessions = dataclasses.replace(self.sessions, table=kept)
        tolerance = max(_TOLERANCE, self.data.asked.tolerance)
        scene = self.scene.with_inference(tolerance=tolerance)
        try:
            return Displayed(Data(sessions, scene), self.progress, self.store).verdict_rows
        except RefusalError:
            return ()

    @part
    def without_maps(self) -> Iterator[Skipped | None]:
        """Note why there is no map of couplings, or of devices, and which there are."""
        if others := len(self.with_reference) - len(self._shown):
            what = f"curves and couplings of {counted(others, 'more environment')}"
            yield Skipped(what, "Study.boundaries_of draws curves of any")
        if self.setup is not None:
            yield no_other_devices(self.setup, self.map_users)
            if self.setup.coupling is not None:
                yield no_coupling_map(self.setup, self.map_users)

    @cached_property
    def coupling_map(self) -> AdmissibleCouplings | None:
        """How probably stable couplings feel real, and the ends of those that do."""
        if self.setup is None:
            return None
        return coupling_map(self.setup, self.map_users, self.scene)

    @property
    def design(self) -> AdmissibleCouplings | None:
        """The map of couplings, where there is a coupling to compare with."""
        return self.coupling_map if self.scene.coupling else None

    @cached_property
    def other_devices(self) -> OtherDevices | None:
        """How verdicts move with the device's mass and damping; None without both."""
        if self.setup is None:
            return None
        return other_devices(self.setup, self.map_users, self.scene)
