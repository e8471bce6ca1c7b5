"""What to analyse: device, coupling, inference and model, from TOML to records."""

from __future__ import annotations

import dataclasses
import math
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    StrictBool,
    ValidationInfo,
    field_validator,
    model_validator,
)

from percept.errors import UsageError
from percept.html import fields_html
from percept.scene_device import CouplingTable, DeviceTable, Positive
from percept.sessions.options import DataTables, Term, terms_of
from percept.sessions.quantities import Table, amount_in, is_impedance, known_key


def _probability(value: float) -> float:
    if not 0.0 < value < 1.0:
        hint = f"; {value:g} percent is written {value / 100:g}" if 1.0 < value < 100.0 else ""
        raise ValueError(f"must lie between 0 and 1{hint}")
    return value


_BETWEEN: dict[str, Any] = {"exclusiveMinimum": 0, "exclusiveMaximum": 1}
Probability = Annotated[
    float, Field(strict=True, json_schema_extra=_BETWEEN), AfterValidator(_probability)
]
#: An interval of a lower level has no width that doubles resolve.
_LEAST_LEVEL = 1e-6
Level = Annotated[Probability, Field(ge=_LEAST_LEVEL)]


#: Below one half "feels real" and "does not" could both hold.
Decision = Annotated[float, Field(strict=True, gt=0.5, lt=1.0)]
Kind = Literal["mean", "user", "share"]
# At Nyquist itself a sampled mass has no finite impedance. Written with fewer digits it may come
# out below.
_NYQUIST_ANGLE = math.pi - 1e-9
#: rad/s; impedances are held to exact arithmetic from here on.
_LEAST_OMEGA = 1e-9
#: JSON readers take whole numbers up to here.
_LARGEST_SEED = 2**53


class FrequencyTable(Table):
    """The perceivable range, rad/s, and how many frequencies a curve has."""

    lower: Annotated[Positive, Field(ge=_LEAST_OMEGA)] = 0.1
    upper: Positive = 100.0
    points: Annotated[int, Field(ge=2, le=100_000, strict=True)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.lower < self.upper:
            raise ValueError(f"lower, {self.lower:g}, must be below upper, {self.upper:g}")
        return self

    @property
    def read_at(self) -> float:
        """Where single values are read, rad/s: at the paper's 10, or mid-range without it."""
        usual = 10.0
        return usual if self.lower <= usual <= self.upper else math.sqrt(self.lower * self.upper)


class InferenceTable(Table):
    """Levels, family and accuracy of the intervals; `share` is `[verdict] central` by default.

    One or two quantities have a model together; of more, `together` names two that have one.
    """

    level: Level = 0.99
    share: Level = 0.99
    confidence: Level = 0.95
    decision: Decision = 0.95
    family: Literal["lognormal", "normal"] = "lognormal"
    method: Literal["both", "classical", "bayesian"] = "both"
    kinds: tuple[Kind, ...] = ("mean", "user", "share")
    parameters: tuple[str, ...] | None = None
    together: tuple[str, ...] | None = None
    tolerance: Probability = 0.01
    seed: Annotated[int, Field(ge=0, le=_LARGEST_SEED, strict=True)] = 1
    most_steps: Annotated[int, Field(ge=200, le=10**9, strict=True)] = 20_000

    @field_validator("kinds", "parameters", "together")
    @classmethod
    def _each_once(
        cls, chosen: tuple[str, ...] | None, info: ValidationInfo
    ) -> tuple[str, ...] | None:
        if chosen is None:
            return None
        if not chosen:
            raise ValueError("give at least one, or leave the key out")
        if repeated := [name for name in chosen if chosen.count(name) > 1]:
            raise ValueError(f"{repeated[0]} stands there twice")
        # One order, whatever the file's; that of quantities is known to the scene.
        return (
            tuple(k for k in get_args(Kind) if k in chosen)
            if info.field_name == "kinds"
            else chosen
        )


class VerdictTable(Table):
    """What feels real: what lies among the values that the `central` share of users would set."""

    central: Level = 0.99


class ModelTable(Table):
    """The hierarchical model: pooling, priors and simpler variants.

    `scale` gives a parameter with a reference of zero a unit to divide by, under the normal family.
    `bias` says which columns of the sessions move the bias, such as "hand * load + start": columns
    of words are factors, and columns of numbers covariates. The name "reference" in it is each
    trial's own reference, where that differs within an environment. The levels of the factors
    named in `spread` differ in how far subjects lie apart; all factors, by default. For those named
    in `precision` the contrasts hold ratios of SDs between trials, and so of JNDs.
    `subjects_trial_sd` gives subjects trial SDs of their own: "auto" where half of at most 60
    subjects have eight trials or more beyond the first of each cell, or `precision` names a factor.
    There must be two cells or more, and every subject who repeats trials must set different values.
    `resolution` is the step of the adjustment. Its variance, step²/12, stands in for scatter in
    cells that show none or whose parameters move in proportion. percept adds it nowhere else.
    """

    pooling: Literal["partial", "none"] = "partial"
    prior: Literal["default", "reference"] = "default"
    priors: dict[str, Annotated[float, Field(strict=True)]] = Field(default_factory=dict)
    subject_effect: StrictBool = True
    weber: StrictBool = False
    common_spread: StrictBool = False
    subjects_trial_sd: StrictBool | Literal["auto"] = "auto"
    bias: Annotated[str, Field(min_length=1)] | None = None
    spread: Annotated[str, Field(min_length=1)] | None = None
    precision: Annotated[str, Field(min_length=1)] | None = None
    scale: dict[str, Positive] = Field(default_factory=dict)
    resolution: dict[str, Positive] = Field(default_factory=dict)

    @field_validator("priors")
    @classmethod
    def _priors_of_the_model(cls, priors: dict[str, float]) -> dict[str, float]:
        # SciPy comes with them: files are validated and studies planned without it.
        from percept.inference.model.priors import Priors

        known = [field.name for field in dataclasses.fields(Priors)]
        for name, value in priors.items():
            known_key(known, name, name, value)
        Priors(**priors)
        return priors

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key in ("bias", "spread", "precision"):
            formula = getattr(self, key)
            if formula is not None:
                terms_of(formula, key=key)
        if (self.pooling == "none") != (self.prior == "reference"):
            raise ValueError('pooling = "none" and prior = "reference" go together')
        if self.pooling == "none" and self.resolution:
            raise ValueError('resolution goes with pooling = "partial"')
        return self


class ChecksTable(Table):
    """Asks for checks of the model, which `percept report` always makes; it has no keys."""


def _plural(word: str) -> str:
    """Write the plural of an English noun that follows the rules."""
    if word.endswith("y") and word[-2:-1] not in "aeiou":
        return f"{word[:-1]}ies"
    return f"{word}es" if word.endswith(("s", "x", "ch", "sh")) else f"{word}s"


def _noun(value: Any) -> Any:
    """Take a noun with its plural, or work the plural out."""
    return (value, _plural(value)) if isinstance(value, str) and value else value


Noun = Annotated[tuple[str, str], BeforeValidator(_noun)]


_SUBJECT = ("subject", "subjects")


def _jnd(value: Any) -> Any:
    """Take a positive number, or text, which the scene holds to its quantity."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if isinstance(value, str) or (number and 0.0 < value < math.inf):
        return value
    raise ValueError('must be a positive fraction of the reference, a value with unit, or "trials"')


Jnd = Annotated[float | str, BeforeValidator(_jnd)]


class StudyTable(Table):
    """What the study calls its environments and subjects, as a noun or as singular and plural.

    Without a word environments are "conditions" where the quantities adjusted make no impedance.
    `verb` is what subjects did to a quantity, in the past tense, such as "rated".
    `factor` is a column of conditions or groups, whose levels are compared two by two: the short
    form of `[model] bias`. `jnd` is the just noticeable difference that each bias is held against:
    a fraction of the reference, a value with its unit, or "trials" for the SD of adjustment.
    """

    environment: Noun | None = None
    subject: Noun = _SUBJECT
    verb: Annotated[str, Field(min_length=1)] = "set"
    factor: Annotated[str, Field(min_length=1)] | None = None
    jnd: dict[str, Jnd] = Field(default_factory=dict)


class ReportTable(Table):
    """What a report shows: its title and notes, and which curves.

    `curves` is "family" for boundaries of the scene's family, or "all". An environment
    without curves in this family gets the curves of the other. Intervals come in both families.
    """

    title: str | None = None
    subtitle: str | None = None
    note: str | None = None
    curves: Literal["family", "all"] = "family"


class Scene(DataTables):
    """An analysis: every table is optional, and what depends on a missing one is skipped.

    Parameters are keyword arguments named after the tables of the TOML form. `columns`, `sessions`
    and `environments` say how session files are read.
    """

    device: DeviceTable | None = None
    coupling: CouplingTable | None = None
    frequency: FrequencyTable = FrequencyTable()
    inference: InferenceTable = InferenceTable()
    verdict: VerdictTable = VerdictTable()
    model: ModelTable = ModelTable()
    checks: ChecksTable | None = None
    study: StudyTable = StudyTable()
    report: ReportTable = ReportTable()
    _folder: Path = PrivateAttr(default=Path())

    def __init__(self, /, *paths: Any, **tables: Any) -> None:
        if paths:
            raise UsageError(f"a scene's file is read by Scene.load({str(paths[0])!r}).")
        super().__init__(**tables)

    @model_validator(mode="before")
    @classmethod
    def _share(cls, tables: Any) -> Any:
        """Let the share of intervals be that of verdicts, unless it is given."""
        verdict = tables.get("verdict")
        asked = tables.get("inference", {})
        if isinstance(verdict, dict) and "central" in verdict and isinstance(asked, dict):
            return tables | {"inference": {"share": verdict["central"]} | asked}
        return tables

    @model_validator(mode="after")
    def _of_the_quantities(self) -> Self:
        """Hold every key that names quantities to those there are."""
        asked, model = self.inference, self.model
        for key, names in (
            ("inference.parameters", asked.parameters),
            ("inference.together", asked.together),
            ("model.scale", model.scale),
            ("model.resolution", model.resolution),
            ("study.jnd", self.study.jnd),
        ):
            for name in names or ():
                if name not in self.quantities:
                    known = ", ".join(self.quantities)
                    raise UsageError(
                        f"there is no such quantity; there are {known}.", key=key, value=name
                    )
        for key in ("parameters", "together"):
            if (names := getattr(asked, key)) is not None:
                object.__setattr__(asked, key, tuple(q for q in self.quantities if q in names))
        for name, jnd in self.study.jnd.items():
            if isinstance(jnd, str) and jnd != "trials":
                amount_in(self.quantities[name], jnd, key=f"study.jnd.{name}")
        if asked.together is not None and len(asked.together) != 2:
            raise UsageError("two quantities have a model together.", key="inference.together")
        return self

    @model_validator(mode="after")
    def _below_nyquist(self) -> Self:
        if self.device is None or self.frequency.upper * self.device.period < _NYQUIST_ANGLE:
            return self
        period = self.device.period
        raise UsageError(
            f"does not lie below the Nyquist frequency, {math.pi / period:.6g} rad/s at a period of"
            f" {period:g} s.",
            key="frequency.upper",
            value=self.frequency.upper,
            hint=(
                "Set upper of [frequency] below that (it is 100 by default), or correct period of"
                " [device]."
            ),
        )

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms beside environment, trend and subject: columns, alone or interacting."""
        bias, factor = self.model.bias, self.study.factor
        terms = terms_of(bias, key="model.bias") if bias else ()
        return terms if factor is None or (factor,) in terms else ((factor,), *terms)

    @property
    def family(self) -> str:
        """Family of the analysis; the normal one takes zeros and negative values."""
        return self.inference.family

    @property
    def environment_noun(self) -> tuple[str, str]:
        """What environments are called, one and several."""
        usual = _noun("environment" if is_impedance(self.quantities) else "condition")
        return self.study.environment or usual

    @property
    def user_noun(self) -> tuple[str, str]:
        """What the people of a result are called, one and several."""
        return _noun("user") if self.study.subject == _SUBJECT else self.study.subject

    @property
    def folder(self) -> Path:
        """Where relative paths in the scene start: the folder of its file, or this one."""
        return self._folder

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a scene from TOML.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Scene

        Raises
        ------
        UsageError
            If the file cannot be read, is not TOML, or a key or value is wrong; with the place.
        """
        name = str(path)
        try:
            tables = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise UsageError(f"cannot be read: {error.strerror}.", file=name) from error
        # Among them are too many digits and nested lists.
        except (ValueError, RecursionError) as error:
            hint = "Text stands in quotes, and numbers begin with a digit: 0.05."
            raise UsageError(f"is not TOML: {error}.", file=name, hint=hint) from error
        try:
            scene = cls(**tables)
        except UsageError as error:
            error.file = name
            raise
        scene._folder = Path(path).parent
        return scene

    def to_dict(self) -> dict[str, Any]:
        """Return plain nested tables with all defaults, without keys and tables that are None."""
        return self.model_dump(mode="json", exclude_none=True)

    def _repr_html_(self) -> str:
        return fields_html(self.to_dict())

    def with_inference(self, **changes: Any) -> Scene:
        """Return a copy with keys of `[inference]` replaced; None leaves a key as it is."""
        kept = {key: value for key, value in changes.items() if value is not None}
        return self.with_tables(inference=self.inference.model_dump(exclude_none=True) | kept)

    def with_tables(self, **tables: dict[str, Any] | None) -> Scene:
        """Return a copy with whole tables replaced and checked; None leaves one out."""
        changed = Scene(**self.model_dump(exclude_none=True) | tables)
        changed._folder = self._folder
        return changed
