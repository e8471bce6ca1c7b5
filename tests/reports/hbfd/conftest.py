import json
from dataclasses import replace
from decimal import Decimal
from types import SimpleNamespace

import pytest

from reports.hbfd.__main__ import main
from reports.hbfd.published import Published, load_published


@pytest.fixture(scope="session")
def published():
    return load_published()


@pytest.fixture(scope="session")
def written(tmp_path_factory):
    """The folder the command writes."""
    folder = tmp_path_factory.mktemp("reproduction") / "out"
    assert main(["--out", str(folder), "--quiet"]) == 0
    return folder


@pytest.fixture(scope="session")
def claims(written):
    """The claims the command writes, by name."""
    text = (written / "claims.json").read_text(encoding="utf-8")
    document = json.loads(text, object_hook=lambda table: SimpleNamespace(**table))
    return {claim.name: claim for claim in document.claims}


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
