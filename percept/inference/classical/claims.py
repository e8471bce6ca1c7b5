"""What an interval is asked to hold, checked once for every kind and family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from percept.errors import UsageError
from percept.inference.classical.levels import Level, tail
from percept.inference.intervals import Family, Joint, Side

__all__ = ["Claim", "Parametric", "parametric_family"]

Parametric: TypeAlias = Literal["normal", "lognormal"]


@dataclass(frozen=True)
class Claim:
    """What is asked of an interval, of whatever kind.

    Parameters
    ----------
    level : float or OneMinus
        Confidence level.
    family : {"normal", "lognormal", "free"}
        Distribution between users.
    joint : {"marginal", "bonferroni"}
        ``"bonferroni"`` halves every tail, so that two parameters hold together.
    side : {"both", "lower", "upper"}
        Which limits are wanted.
    unit : str
        Unit of the values.
    share, confidence : float or OneMinus, optional
        For kind ``"share"``.
    """

    level: Level = 0.99
    family: Family = "normal"
    joint: Joint = "marginal"
    side: Side = "both"
    unit: str = ""
    share: Level | None = None
    confidence: Level | None = None

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
        """Return what `name` leaves out, halved where two parameters share it.

        Parameters
        ----------
        name : {"level", "share", "confidence"}
            Which probability.

        Returns
        -------
        float
            In (0, 1).
        """
        left = float(tail(getattr(self, name), name))
        return left / 2.0 if self.joint == "bonferroni" else left

    @property
    def tails(self) -> int:
        """Over how many tails a level is spread."""
        return 2 if self.side == "both" else 1


def parametric_family(family: Parametric) -> Parametric:
    """Return `family` if it has parameters.

    Raises
    ------
    UsageError
        Anything but "normal" or "lognormal".
    """
    if family not in ("normal", "lognormal"):
        raise UsageError('family must be "normal" or "lognormal" here.', value=family)
    return family
