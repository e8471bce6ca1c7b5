"""The control loop between samples: its hold, and how late it is."""

from __future__ import annotations

from dataclasses import dataclass

from percept.errors import UsageError
from percept.haptics.arrays import one_of, real_array

__all__ = ["HOLDS", "AnyHold", "Hold", "hold_of"]

HOLDS = ("average", "true")

# In samples. Searches over frequency then need 40,000 points; a loop so late renders nothing.
_LONGEST_DELAY = 1000.0


@dataclass(frozen=True)
class Hold:
    """How the loop puts out a force: the kind of hold, and a delay before it.

    Parameters
    ----------
    kind : {"average", "true"}
        Eq. 8, or the true zero-order hold.
    delay : float
        d, samples, zero or more; fractions are allowed. The hold is multiplied by e^{−jdωT}.

    Raises
    ------
    UsageError
        An unknown kind, or a delay that is negative, not finite or above 1,000 samples.
    """

    kind: str = "average"
    delay: float = 0.0

    def __post_init__(self) -> None:
        one_of(self.kind, "hold", HOLDS)
        delay = real_array(self.delay, "delay", "samples")
        if delay.ndim or not 0 <= delay <= _LONGEST_DELAY:
            raise UsageError(
                f"delay must be one number of samples, 0 to {_LONGEST_DELAY:g}.",
                value=self.delay,
                hint="A delay in seconds is divided by the sampling period.",
            )
        object.__setattr__(self, "delay", float(delay))


AnyHold = str | Hold
"""What every argument called `hold` accepts: a record, or the kind of a hold without delay."""


def hold_of(hold: AnyHold) -> Hold:
    """Return the record of a hold."""
    return hold if isinstance(hold, Hold) else Hold(hold)
