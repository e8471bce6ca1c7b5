"""What a section hands to the page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Part:
    """A section of the page.

    Attributes
    ----------
    name : str
        Id on the page, and name of its template.
    title : str
        Heading.
    values : mapping
        What the template reads.
    """

    name: str
    title: str
    values: Mapping[str, Any] = field(default_factory=dict)
