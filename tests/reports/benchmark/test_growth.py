import numpy as np
import pytest

from reports.benchmark.growth import growth, growth_study


def held(statistics):
    """Shapes of every array the density reads."""
    patterns = [(p.environments.shape, p.mean.shape, p.rows.shape) for p in statistics.patterns]
    return patterns, statistics.trial_rows.shape, statistics.x.shape


def test_what_the_density_reads_does_not_grow_with_rows_or_alike_subjects():
    few, many = (growth_study("trial rows", rows) for rows in (50, 50_000))
    assert held(few) == held(many)
    assert [statistics.trial_df.sum() for statistics in (few, many)] == [50 - 25, 50_000 - 25]
    few, many = (growth_study("subjects, equal patterns", subjects) for subjects in (20, 2_000))
    assert held(few) == held(many)
    assert [statistics.patterns[0].subjects for statistics in (few, many)] == [20, 2_000]


@pytest.mark.parametrize("size", [1, 7, 40])
def test_as_many_patterns_and_environments_as_asked(size):
    patterns = growth_study("patterns", size)
    assert len(patterns.patterns) == size
    assert sum(pattern.subjects for pattern in patterns.patterns) == 40
    assert patterns.repeats
    assert len(growth_study("environments", size).environments) == size


def test_rows_keep_the_scatter_they_were_drawn_with():
    statistics = growth_study("trial rows", 50_000)
    sd = np.sqrt((statistics.trial_rows**2).sum(axis=1) / statistics.trial_df)
    # An SD from f degrees of freedom has a relative standard error of 1/sqrt(2 f).
    assert np.abs(sd / 0.05 - 1.0).max() < 4.5 / np.sqrt(2.0 * statistics.trial_df.min())


def test_every_size_is_timed_against_the_smallest():
    sizes = {"environments": (1, 3), "frequencies": (10, 40), "draws": (100, 400)}
    found = growth(rounds=3, sizes=sizes)
    assert [(row.task, row.along, row.size) for row in found] == [
        ("density call", "environments", 1), ("density call", "environments", 3),
        ("propagation", "frequencies", 10), ("propagation", "frequencies", 40),
        ("propagation", "draws", 100), ("propagation", "draws", 400),
    ]  # fmt: skip
    for row in found:
        assert row.ratio > 0.0
        assert row.seconds > 0.0
    assert all(row.ratio == 1.0 for row in found[::2])
    assert growth(rounds=1, sizes={"trial rows": (50,)})[0].promised == 1.1
