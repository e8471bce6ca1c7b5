"""What an interval is asked to hold, checked once for every kind and family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from percept.errors import UsageError
from percept.inference.classical.levels import Level, tail
from percept.inference.intervals import Family, Joint, Side

Parametric: TypeAlias = Literal["normal", "lognormal"]


@dataclass(frozen=True)
class Claim:
    """What is asked of an interval, of whatever kind."""

    level: Level = 0.99  # Confidence level
    family: Family = "normal"  # Distribution between users
    joint: Joint = "marginal"  # ``"bonferroni"`` halves every tail, so that two parameters hold together
    side: Side = "both"  # Which limits are wanted
    unit: str = ""  # Unit of the values
    share: Level | None = None  # For kind ``"share"``
    confidence: Level | None = None  # For kind ``"share"``

    def __post_init__(self) -> None:
        for name, known in (
            ("family", ("normal", "lognormal", "free")),
            ("joint", ("marginal", "bonferroni")),
            ("side", ("both", "lower", "upper")),
        ):
            if getattr(self, name) not in known:
                options = ", ".join(f'"{option}"' for option in known)
                raise UsageError(f"{name} must be one of {options}.", value=getattr(self, name))
        for name in ("level", "share", "confidence"):
            level = getattr(self, name)
            if level is not None and tail(level, name).ndim:
                raise UsageError(f"{name} must be one number for an interval.", value=level)

    def tail(self, name: str = "level") -> float:
        """Return what `name` leaves out, halved where two parameters share it."""
        left = float(tail(getattr(self, name), name))
        return left / 2.0 if self.joint == "bonferroni" else left

    @property
    def tails(self) -> int:
        """Over how many tails a level is spread."""
        return 2 if self.side == "both" else 1


def parametric_family(family: Parametric) -> Parametric:
    """Return `family` if it has parameters."""
    if family not in ("normal", "lognormal"):
        raise UsageError('family must be "normal" or "lognormal" here.', value=family)
    return family
