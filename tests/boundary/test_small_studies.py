"""Small studies get their curves and a page; `make evidence` takes 180 subsets and 80 at random."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests import LONG
from tests.boundary.small_studies import RANDOM, curves_of, pages_of, subsets

SUBSETS = [*subsets(3), *subsets(4)] if LONG else [("S01", "S02", "S03")]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("subjects", SUBSETS, ids="-".join)
def test_curves_of_few_subjects_are_drawn_or_said_to_be_missing(subjects: tuple[str, ...]) -> None:
    study = curves_of(subjects, environments=5 if LONG else 2)
    assert {boundary.environment for boundary in study.boundaries} == set(study.data.environments)


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("seed", range(RANDOM) if LONG else [1])
def test_a_random_small_study_gets_its_page(tmp_path: Path, seed: int) -> None:
    pages_of(seed, tmp_path)
