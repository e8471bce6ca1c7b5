from dataclasses import replace
from decimal import Decimal

import pytest

from reports.hbfd.judging import judge_all
from reports.hbfd.published import Published, load_published


@pytest.fixture(scope="session")
def published():
    return load_published()


@pytest.fixture(scope="session")
def claims(published):
    """The claims by name."""
    return {claim.name: claim for claim in judge_all(published)}


@pytest.fixture(scope="session")
def changed(published):
    """Return the paper with some cells of its table replaced: {(environment, parameter, column):
    text}."""

    def change(cells=None, **fields):
        columns = {name: [list(row) for row in getattr(published.limits, name)] for name in COLUMNS}
        for (environment, parameter, column), text in (cells or {}).items():
            row = published.limits.environments.index(environment)
            columns[column][row]["kb".index(parameter)] = Decimal(text)
        frozen = {name: tuple(tuple(row) for row in rows) for name, rows in columns.items()}
        return Published(
            replace(published.limits, **frozen, **fields), published.scene, published.files
        )

    return change


COLUMNS = ("reference", "lower", "upper")
