"""Small studies get their curves and a page; `python -m tests.boundary.small_studies` does all
of them."""

from __future__ import annotations

from pathlib import Path

from tests.boundary.small_studies import curves_of, pages_of


def test_curves_of_three_subjects_are_drawn_or_said_to_be_missing() -> None:
    study = curves_of(("S01", "S02", "S03"), environments=2)
    assert {boundary.environment for boundary in study.boundaries} == set(study.parts.environments)


def test_a_random_small_study_gets_its_page(tmp_path: Path) -> None:
    pages_of(1, tmp_path)
