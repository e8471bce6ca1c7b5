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
    IntervalWithout,
    LeftOut,
    NormalityTest,
    PredictiveCheck,
    Prior,
    SubjectCheck,
)
from percept.results.coupling import (
    AdmissibleCouplings,
    CentralProbability,
    ChangedVerdict,
    Confidences,
    ConfirmedCoupling,
    Coupling,
    DeviceStability,
    EnvironmentCouplings,
    Leaning,
    Membership,
    MoreSubjects,
    OtherDevices,
    PosteriorEvidence,
    Rendered,
    RenderedEdge,
    RenderedWall,
    Verdict,
    ZWidth,
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
    SubjectRow,
)
from percept.results.findings import (
    Findings,
    Overview,
    OverviewRow,
)
from percept.results.intervals import (
    AnovaRow,
    BandDifference,
    BandPair,
    ContrastRow,
    IntervalRow,
    Ladder,
    LadderEffect,
    LevelValues,
    MethodPair,
)
from percept.results.plain import dumps, plain
from percept.results.psychophysics import EquivalenceRow, PseLineRow, PsychophysicsRow
from percept.results.results import SCHEMA, Part, Results, Skipped

__all__ = [
    "SCHEMA", "AdmissibleCouplings", "AnovaRow", "Band", "BandDifference", "BandLaw", "BandPair",
    "BandRow", "BandStatement", "Boundary", "CellOutlier", "CellValues", "CentralProbability",
    "ChangedVerdict", "Checks", "Confidences", "ConfirmedCoupling", "ContrastRow", "Coupling",
    "Data", "DesignCounts", "DeviceStability", "Diagnostics", "EnvironmentCouplings",
    "EquivalenceRow", "Estimate", "Findings", "GateVerdict", "IntervalRow", "IntervalWithout",
    "Ladder", "LadderEffect", "Leaning", "LeftOut", "LeftOutRow", "LevelValues", "Membership",
    "MethodPair", "MoreSubjects", "NormalityTest", "Note", "Nouns", "OtherDevices", "Overview",
    "OverviewRow", "Part", "PosteriorEvidence", "PredictiveCheck", "Prior",
    "Provenance", "PseLineRow", "PsychophysicsRow", "Rendered", "RenderedEdge", "RenderedWall",
    "Results", "Shape", "Skipped", "SourceFile", "SubjectCheck", "SubjectRow", "Verdict",
    "WeberTrend", "ZWidth", "dumps", "plain",
]  # fmt: skip
