"""What an analysis gives, as frozen records; one schema writes and reads them as report.json."""

from percept.results.boundaries import (
    Band,
    BandLaw,
    BandRow,
    BandStatement,
    Boundary,
    Estimate,
    Shape,
    WeberTrend,
)
from percept.results.checks import (
    CellOutlier,
    Checks,
    Diagnostics,
    GateVerdict,
    LeftOut,
    NormalityTest,
    PredictiveCheck,
    Prior,
    PriorQuantiles,
    SubjectCheck,
)
from percept.results.coupling import (
    AdmissibleCouplings,
    Confidences,
    ConfirmedCoupling,
    Coupling,
    DeviceMap,
    DeviceProbabilities,
    EnvironmentCouplings,
    Leaning,
    Membership,
    MoreSubjects,
    Passivity,
    PosteriorEvidence,
    Verdict,
)
from percept.results.data import (
    CellValues,
    Data,
    DesignCounts,
    LeftOutRow,
    Note,
    Nouns,
    Provenance,
    SourceFile,
)
from percept.results.findings import (
    Findings,
    Overview,
    OverviewRow,
    ReferenceName,
    ReferencesInside,
)
from percept.results.intervals import (
    BandDifference,
    BandPair,
    ContrastRow,
    IntervalRow,
    Ladder,
    LadderEffect,
    MethodPair,
)
from percept.results.plain import dumps, plain
from percept.results.results import SCHEMA, Results, Skipped

__all__ = [
    "SCHEMA", "AdmissibleCouplings", "Band", "BandDifference", "BandLaw", "BandPair", "BandRow",
    "BandStatement", "Boundary", "CellOutlier", "CellValues", "Checks", "Confidences",
    "ConfirmedCoupling", "ContrastRow", "Coupling", "Data", "DesignCounts", "DeviceMap",
    "DeviceProbabilities", "Diagnostics", "EnvironmentCouplings", "Estimate", "Findings",
    "GateVerdict", "IntervalRow", "Ladder", "LadderEffect", "Leaning", "LeftOut", "LeftOutRow",
    "Membership", "MethodPair", "MoreSubjects", "NormalityTest", "Note", "Nouns", "Overview",
    "OverviewRow", "Passivity", "PosteriorEvidence", "PredictiveCheck", "Prior", "PriorQuantiles",
    "Provenance", "ReferenceName", "ReferencesInside", "Results", "Shape", "Skipped", "SourceFile",
    "SubjectCheck", "Verdict", "WeberTrend", "dumps", "plain",
]  # fmt: skip
