"""The formats of figures' files."""

from __future__ import annotations

from collections.abc import Sequence

from percept.errors import UsageError

FORMATS = ("svg", "pdf", "png")


def check_formats(formats: Sequence[str]) -> None:
    """Raise UsageError for a format that figures do not come in."""
    for form in formats:
        if form not in FORMATS:
            raise UsageError(f"figures come as {', '.join(FORMATS)}.", value=form)
