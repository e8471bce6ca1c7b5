"""How to read a study's files: tables of the scene, checked key by key."""

from __future__ import annotations

import itertools
import re
from collections.abc import Container, Iterable, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, ValidationError, model_validator

from percept.errors import UsageError
from percept.sessions.quantities import (
    IMPEDANCE,
    TO_FILL_IN,
    Quantity,
    Table,
    factor,
    known_key,
    quantity_of,
    unfilled,
    usage_error,
    with_mass,
)
from percept.sessions.records import IDS, MASS, MOMENTS_COLUMNS, SUMMARY_COLUMNS
from percept.sessions.values import LARGEST, LEAST, MISSING

#: Columns kept as text wherever they stand: groups of subjects, and whether data are simulated.
KEPT_COLUMNS = ("group", "source")
#: A term of a model: one column, or several that interact.
Term = tuple[str, ...]
#: In `[model] bias` the reference of the trial, which no column of the files has that name for.
TRIAL_REFERENCE = "reference"


def _as_texts(value: Any) -> Any:
    """Take a single text for a list of one, and whole numbers for their digits."""
    items = [value] if isinstance(value, str | int) else value
    if not isinstance(items, list | tuple):
        raise ValueError("must be a text or a list of texts")
    return tuple(str(item) if type(item) is int else item for item in items)


def _checked_pattern(value: str) -> str:
    """Hold a pattern of file names to the ids that it may name."""
    names = re.findall(r"\{(\w+)\}", value)
    if not names or not set(names) <= set(IDS) or len(set(names)) < len(names):
        raise ValueError("must name {subject}, {session} or {environment}, each once")
    return value


Text = Annotated[str, Field(min_length=1)]
Texts = Annotated[tuple[str, ...], BeforeValidator(_as_texts)]


def in_range(value: float) -> float:
    """Refuse a number that products of three would leave the doubles with."""
    if value and not LEAST <= abs(value) <= LARGEST:
        raise ValueError(f"must be between {LEAST:g} and {LARGEST:g} in size")
    return value


#: Most is more than any file has, and few enough bytes to ask a file for.
Count = Annotated[int, Field(ge=1, le=1 << 50, strict=True)]
Number = Annotated[float, Field(strict=True, allow_inf_nan=False), AfterValidator(in_range)]


class ColumnRule(Table):
    """Where a canonical column stands in the files.

    Attributes
    ----------
    name : str
        The file's own column name. `{environment}` and `{trial}` in it make the table a wide one.
    unit : str, optional
        Unit of the file's numbers; None means the quantity's own, N/m for stiffness and N·s/m for
        damping.
    path : str, optional
        Dotted path into a JSON cell ("response.k"; a number picks from a list, -1 its last item).
    scale : float
        Multiplies the file's numbers: for a unit without a name.
    response : {"ratio", "difference"}, optional
        What the numbers of an adjustment are, if not the quantity itself: its ratio to the
        reference, or its difference from it.
    """

    name: Text
    unit: str | None = None
    path: str | None = None
    scale: Number = 1.0
    response: Literal["ratio", "difference"] | None = None

    @model_validator(mode="after")
    def _units_of_the_quantity(self) -> Self:
        """Hold units, scale and name to what the numbers are."""
        if self.response == "ratio" and self.unit is not None:
            raise ValueError('numbers of response = "ratio" have no unit')
        if self.scale == 0:
            raise ValueError("scale must not be zero")
        if any(self.name.count(f"{{{name}}}") > 1 for name in (*IDS, "trial")):
            raise ValueError("names an id twice")
        return self


class ExcludeRule(Table):
    """Observations to leave out, and why.

    Attributes
    ----------
    column : str
        A canonical name (values in the quantity's unit) or one of the file's own columns.
    why : str
        The reason, as it is counted and reported; by default the rule in words.
    equals : tuple of str
        Leave out rows whose cell is one of these texts.
    below, above : float, optional
        Leave out rows whose number is below or above.
    """

    column: Text
    why: str = ""
    equals: Texts = ()
    below: Number | None = None
    above: Number | None = None

    @model_validator(mode="after")
    def _texts_or_limits(self) -> Self:
        """Hold a rule to texts or to limits, and give it a reason in words."""
        limits = {"below": self.below, "above": self.above}
        words = [f"{name} {limit:g}" for name, limit in limits.items() if limit is not None]
        if bool(self.equals) == bool(words):
            raise ValueError("a rule has column, why, and either equals or limits (below, above)")
        if not self.why:
            object.__setattr__(self, "why", f"{self.column} is {' or '.join(self.equals or words)}")
        return self


def _as_rule(value: Any) -> Any:
    """Take a name for the table of a column rule."""
    if not isinstance(value, str | Mapping | ColumnRule):
        raise ValueError("a column is a name, or a table of name, unit and path")
    return {"name": value} if isinstance(value, str) else value


def canonical_columns(quantities: Iterable[str]) -> tuple[str, ...]:
    """Name the columns that an analysis of trials reads: ids, references, then adjustments."""
    names = list(quantities)
    columns = [*IDS, "trial", *(f"{name}_ref" for name in names)]
    # A third quantity leaves k and b an impedance.
    if IMPEDANCE.keys() <= set(names):
        columns.append(MASS)
    return (*columns, *(f"{name}_adj" for name in names))


def _with_names(value: Any) -> Any:
    """Give each quantity of a scene the name of its table; without any, k and b are adjusted."""
    if not isinstance(value, Mapping):
        return value
    tables = {
        name: {"name": name, **table} if isinstance(table, Mapping) else table
        for name, table in value.items()
    }
    return tables or dict(IMPEDANCE)


class FileLimits(Table):
    """Limits that files meet before they are read, so that a hostile one fills no memory.

    Attributes
    ----------
    rows : int
        Most rows of a file.
    cells : int
        Most cells of one; of a text those that are read.
    size : int
        Most bytes of a file, and that one archive, workbook or stream unpacks to.
    """

    rows: Count = 2_000_000
    cells: Count = 10_000_000
    size: Count = 1 << 30

    def hold_table(self, rows: int, columns: int, file: str) -> None:
        """Refuse a table of more rows or cells."""
        self.hold("rows", rows, file)
        self.hold("cells", rows * columns, file)

    def hold(self, name: str, number: int, file: str) -> None:
        """Refuse a number above the limit of that name."""
        limit = getattr(self, name)
        if number > limit:
            what = "bytes" if name == "size" else name
            hint = f"If it is meant to be so large: [files] {name} = {2 * number} in the scene."
            raise UsageError(f"more than {limit:,} {what}.", file=file, hint=hint)


class SessionsTable(Table):
    """The scene's [sessions]; every default is the strictest reading."""

    decimal: Literal[".", ","] | None = None
    delimiter: Annotated[str, Field(pattern=r'^[^"\r\n\\]$')] | None = None
    encoding: Text | None = None
    keep: Literal["last"] | None = None
    trial: Literal["order"] | None = None
    subject: Literal["row"] | None = None
    layout: Literal["subjects in columns"] | None = None
    filename: Annotated[str, AfterValidator(_checked_pattern)] | None = None
    groups: Texts = ()
    only: dict[str, Texts] = Field(default_factory=dict)
    exclude: tuple[ExcludeRule, ...] = ()
    sheet: Text | None = None
    missing: Texts = ()

    @property
    def marks(self) -> frozenset[str]:
        """Texts that stand for a missing value, in lower case."""
        return MISSING | {text.strip().lower() for text in self.missing}

    @model_validator(mode="after")
    def _trials_or_events(self) -> Self:
        """Refuse rows as trials and as events of trials at once."""
        if self.keep is not None and self.trial is not None:
            raise ValueError(
                'keep = "last" needs a column of trials; trial = "order" makes each row a trial'
            )
        return self


class DataTables(Table):
    """The tables that say what is adjusted, and where it stands in the files."""

    quantities: Annotated[dict[str, Quantity], BeforeValidator(_with_names)] = Field(
        default_factory=lambda: dict(IMPEDANCE)
    )
    columns: dict[str, Annotated[ColumnRule, BeforeValidator(_as_rule)]] = Field(
        default_factory=dict
    )
    environments: dict[str, dict[str, Number]] = Field(default_factory=dict)
    sessions: SessionsTable = SessionsTable()
    files: FileLimits = FileLimits()

    def __init__(self, /, **tables: Any) -> None:
        try:
            super().__init__(**tables)
        except ValidationError as error:
            raise usage_error(error) from error

    @property
    def declared_references(self) -> frozenset[str]:
        """Columns of references that [environments] gives."""
        return frozenset().union(*self.environments.values())

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms beside environment, trend and subject: columns, alone or interacting."""
        return ()

    @property
    def family(self) -> str:
        """Family of the analysis; the normal one takes zeros and negative values."""
        return "lognormal"

    @property
    def split(self) -> tuple[str, ...]:
        """Columns of the files that the terms name."""
        others = {*canonical_columns(self.quantities), TRIAL_REFERENCE}
        names = dict.fromkeys(itertools.chain(*self.terms))
        return tuple(name for name in names if name not in others)

    @property
    def groups(self) -> tuple[str, ...]:
        """Columns that are kept beside percept's own."""
        return tuple(dict.fromkeys((*self.sessions.groups, *self.split)))

    @property
    def trial_references(self) -> bool:
        """Whether trials have references of their own within an environment."""
        return any(TRIAL_REFERENCE in term for term in self.terms)

    def require(self, scene: DataTables) -> None:
        """Refuse a scene whose tables on data the files were not read with."""
        lacking = []
        for name in ("quantities", "columns", "environments", "sessions"):
            table = getattr(scene, name)
            if table and table not in (getattr(self, name), SessionsTable()):
                lacking.append(f"[{name}]")
        if lacking:
            message = f"the sessions were read without {' and '.join(lacking)} of the scene."
            hint = "Read them with it: read_sessions(files, scene=scene)."
            raise UsageError(message, hint=hint)

    @model_validator(mode="before")
    @classmethod
    def _filled_in(cls, given: Any) -> Any:
        """Refuse what nobody has filled in."""
        for name in ("quantities", "columns", "environments"):
            for key in unfilled(given.get(name), name):
                hint = 'Write what is right in the place of each "?"; a reference of zero is 0.0.'
                raise UsageError("is not filled in.", key=key, value=TO_FILL_IN, hint=hint)
        return given

    @model_validator(mode="after")
    def _of_these_quantities(self) -> Self:
        """Hold columns, their units and references to the quantities."""
        columns = (*canonical_columns(self.quantities), *SUMMARY_COLUMNS, *MOMENTS_COLUMNS)
        quantities = with_mass(self.quantities)
        for name, rule in self.columns.items():
            _declared_quantity(name, quantities, f"columns.{name}")
            known_key(tuple(dict.fromkeys(columns)), name, f"columns.{name}")
            if rule.response is not None and not name.endswith("_adj"):
                message = "only an adjustment is a ratio or a difference to its reference."
                raise UsageError(message, key=f"columns.{name}.response")
            if (quantity := quantities.get(quantity_of(name))) is not None:
                factor(rule.unit, quantity, f"columns.{name}.unit")
        references = tuple(f"{name}_ref" for name in quantities)
        for name, given in self.environments.items():
            for key in given:
                _declared_quantity(key, quantities, f"environments.{name}.{key}")
                known_key(references, key, f"environments.{name}.{key}")
        return self


def _declared_quantity(column: str, quantities: Container[str], key: str) -> None:
    """Say how to declare a quantity that a column is of."""
    name = quantity_of(column)
    if column.endswith(("_adj", "_ref")) and name not in quantities:
        message = f"there is no quantity {name!r}."
        hint = f'Declare it in the scene: [quantities.{name}], and below it unit = "…".'
        raise UsageError(message, key=key, hint=hint)


#: More terms are no formula that somebody wrote: products double with each factor.
_MOST_TERMS = 200


def terms_of(formula: str, *, key: str) -> tuple[Term, ...]:
    """Expand a formula in Wilkinson's notation into its terms, main effects first.

    Parameters
    ----------
    formula : str
        Names of columns joined by ``+``, by ``:`` for an interaction, or by ``*`` for main effects
        and interaction; such as "hand * load + start".
    key : str
        The scene's key, for messages.

    Returns
    -------
    tuple of tuple of str
        Each term's columns in the formula's order.

    Raises
    ------
    UsageError
        Anything else, or an interaction of columns without their main effects.
    """
    terms: dict[Term, None] = {}
    for summand in formula.split("+"):
        products: dict[Term, None] = {(): None}
        for joined in summand.split("*"):
            names = [name.strip() for name in joined.split(":")]
            if not all(map(str.isidentifier, names)):
                hint = 'Join names of columns by +, : or *, as in "hand * load + start".'
                raise UsageError("is not a formula.", key=key, value=formula, hint=hint)
            products |= {tuple(dict.fromkeys((*term, *names))): None for term in products}
            if len(products) > _MOST_TERMS:
                message = f"has more than {_MOST_TERMS} terms."
                hint = "Name the interactions that matter, as in a + b + a:b."
                raise UsageError(message, key=key, value=formula, hint=hint)
        terms |= products
    del terms[()]
    for term in terms:
        for part in itertools.combinations(term, len(term) - 1):
            if part and part not in terms:
                message = f"has an interaction without {' : '.join(part)}."
                hint = f"Write {' * '.join(term)} instead of {' : '.join(term)}."
                raise UsageError(message, key=key, value=formula, hint=hint)
    return tuple(sorted(terms, key=len))
