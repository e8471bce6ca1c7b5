from __future__ import annotations

import pandas as pd

from percept.study.intervals import paired_limits


def test_pairs_stand_in_order_and_lone_rows_are_left_out() -> None:
    rows = [("b", "VE2", 1.0, 2.0), ("k", "VE1", 3.0, 4.0), ("k", "VE2", 5.0, 6.0), ("b", "VE3", 7.0, 8.0)]
    table = pd.DataFrame(rows, columns=["parameter", "environment", "lower", "upper"])
    ((pair, limits),) = paired_limits(table, ["environment"])
    assert limits == ((5.0, 6.0), (1.0, 2.0))
    assert {name: row["environment"] for name, row in pair.items()} == {"k": "VE2", "b": "VE2"}
    both = pd.concat([table, table.assign(parameter=["k", "b", "b", "k"])]).drop_duplicates(
        ["parameter", "environment"]
    )
    assert [limits for _, limits in paired_limits(both, ["environment"])] == [
        ((5.0, 6.0), (1.0, 2.0)),
        ((3.0, 4.0), (3.0, 4.0)),
        ((7.0, 8.0), (7.0, 8.0)),
    ]
