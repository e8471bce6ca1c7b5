"""Session files to one checked, tidy table: nothing guessed, nothing lost."""

from __future__ import annotations

from percept.sessions.options import ReadOptions
from percept.sessions.read import read_sessions
from percept.sessions.records import Exclusion, Notice, Sessions, Source

__all__ = ["Exclusion", "Notice", "ReadOptions", "Sessions", "Source", "read_sessions"]
