"""Large files in blocks: the same observations as the careful path, and exact moments."""

from __future__ import annotations

import math
import re
from fractions import Fraction

import numpy as np
import pandas as pd
import pytest

from percept.errors import RefusalError, UsageError
from percept.sessions import ReadOptions, files, grids, read_sessions, reduce_sessions

HEAD = "subject,session,environment,k_ref,b_ref,trial,k_adj,b_adj"


def rows(seed=0, subjects=6, trials=40):
    rng = np.random.default_rng(seed)
    out = []
    for s in range(subjects):
        for e, (k, b) in enumerate([(15.0, 0.7), (1000.0, 1.5), (50000.0, 100.0)]):
            for t in range(trials):
                k_adj, b_adj = k * rng.lognormal(0, 0.1), b * rng.lognormal(0, 0.2)
                out.append(
                    [f"{s:03d}", "1", f"VE{e}", repr(k), repr(b), str(t), repr(k_adj), repr(b_adj)]
                )
    return out


def write(file, records, *, newline="\n", delimiter=",", header=HEAD, end=True):
    lines = [header.replace(",", delimiter), *(delimiter.join(record) for record in records)]
    file.write_text(newline.join(lines) + (newline if end else ""), newline="")
    return file


@pytest.fixture
def blocks(monkeypatch):
    """Make every file large, and every block a few lines."""
    monkeypatch.setattr(files, "BLOCK", 3000)
    monkeypatch.setattr(grids, "_HEAD", 2000)


def whole(monkeypatch, file, options=None):
    with monkeypatch.context() as patch:
        patch.setattr(files, "BLOCK", 1 << 30)
        patch.setattr(grids, "_HEAD", 1 << 30)
        return read_sessions(file, scene=options)


def edited(kind):
    records = rows()
    if kind == "shuffled":
        order = np.random.default_rng(1).permutation(len(records))
        return [records[i] for i in order]
    edits = {
        "missing b": (300, 7, ""),
        "missing words": (301, 6, "NaN"),
        "no adjustment": (302, slice(6, 8), ["null", "None"]),
        "other number style": (303, 6, "+1.5E1"),
        "spaces": (304, 6, " 15.25 "),
        "zero": (305, 7, "0"),
        "id looks like a number": (306, slice(0, 3), ["1e3", "01", "VE0"]),
        "id says NA": (307, slice(0, 3), ["NA", "null", "VE2"]),
        "non-ASCII id": (308, 0, "Jürgen"),
        "blank line": (309, slice(0, 8), [""] * 8),
        "header again": (310, slice(0, 8), HEAD.split(",")),
        "two lines in a cell": (311, 0, '"a\n""b"""'),
    }
    if kind == "quoted":
        return [[f'"{cell}"' for cell in record] for record in records]
    if kind == "quotes escaped":
        return [[f'"{record[0]} \\"b\\", c"', *record[1:]] for record in records]
    if kind in edits:
        at, cell, value = edits[kind]
        records[at][cell] = value
        if kind == "id says NA":
            records[at][3:5] = ["50000.0", "100.0"]
        elif kind == "id looks like a number":
            records[at][3:5] = ["15.0", "0.7"]
    return records


KINDS = [
    "as it is", "shuffled", "missing b", "missing words", "no adjustment", "other number style", "spaces",
    "zero", "id looks like a number", "id says NA", "non-ASCII id", "blank line", "header again",
    "two lines in a cell", "quoted", "quotes escaped",
]  # fmt: skip


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_blocks_give_what_the_careful_path_gives(tmp_path, monkeypatch, kind, newline):
    file = write(tmp_path / "f.csv", edited(kind), newline=newline, end=kind != "as it is")
    want = whole(monkeypatch, file)
    got = read_sessions(file)
    pd.testing.assert_frame_equal(got.table, want.table, check_exact=True)
    pd.testing.assert_frame_equal(got.provenance, want.provenance)
    assert got.sources == want.sources
    assert got.counts == want.counts
    assert got.exclusions == want.exclusions
    assert set(got.notices) == set(want.notices)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize(
    ("cell", "value", "message"),
    [
        (6, "True", "not a number"),
        (6, "1e400", "not between 1e-100 and 1e+100"),
        (6, "1e300", "not between 1e-100 and 1e+100"),
        (6, "1e-400", "not between 1e-100 and 1e+100"),
        (6, "1e-300", "not between 1e-100 and 1e+100"),
        (6, "inf", "not a finite number"),
        (6, "1_5", "not a number"),
        (5, "1.5", "must be whole"),
        (5, "", "an adjustment has no trial"),
        (0, " ", "an adjustment has no subject"),
        (7, "x,y", "9 cells where the header has 8"),
        (3, "16.0", "has the reference 15.0"),
        (5, "1", "is already"),
    ],
)
def test_blocks_refuse_what_the_careful_path_refuses(tmp_path, monkeypatch, cell, value, message):
    records = rows()
    records[200][cell] = value
    if cell == 3:
        records[200][2] = "VE0"
        records[200][0] = "z"
    file = write(tmp_path / "f.csv", records)
    with pytest.raises(UsageError) as careful:
        whole(monkeypatch, file)
    with pytest.raises(UsageError) as streamed:
        read_sessions(file)
    assert message in str(streamed.value)
    assert str(streamed.value) == str(careful.value)
    assert streamed.value.row == careful.value.row


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("value", ["True", "False"])
def test_a_column_of_truth_is_no_column_of_ones(tmp_path, value):
    """pandas reads a block of nothing but True as ones."""
    records = [[*record[:7], value] for record in rows()]
    with pytest.raises(UsageError, match="not a number"):
        read_sessions(write(tmp_path / "f.csv", records))
    records = [[*record[:5], value, *record[6:]] for record in rows()]
    with pytest.raises(UsageError, match="not a number"):
        read_sessions(write(tmp_path / "f.csv", records))


@pytest.mark.usefixtures("blocks")
def test_european_files_units_and_file_names(tmp_path, monkeypatch):
    records = [[cell.replace(".", ",") for cell in record[1:]] for record in rows(subjects=1)]
    file = write(tmp_path / "s01.csv", records, delimiter=";", header=HEAD.partition(",")[2])
    tables = {
        "sessions": {"filename": "s{subject}"},
        "columns": {c: {"name": c, "unit": "N/mm"} for c in ("k_ref", "k_adj")},
    }
    options = ReadOptions.from_mapping(tables)
    got = read_sessions(file, scene=options)
    pd.testing.assert_frame_equal(
        got.table, whole(monkeypatch, file, options).table, check_exact=True
    )
    assert got.table["k_ref"].iloc[0] == 15000.0


def exact(values):
    """Mean and scatter of doubles in rational arithmetic."""
    numbers = [Fraction(v) for v in values]
    mean = sum(numbers) / len(numbers)
    return mean, numbers, len(numbers)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("family", ["lognormal", "normal"])
@pytest.mark.parametrize("kind", ["as it is", "shuffled", "missing b"])
def test_moments_against_rational_arithmetic(tmp_path, family, kind):
    records = edited(kind)
    reduced = reduce_sessions(write(tmp_path / "f.csv", records), family=family)
    cells: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for subject, _, environment, k, b, _, k_adj, b_adj in records:
        if k_adj and b_adj:
            pairs = [(float(k_adj), float(k)), (float(b_adj), float(b))]
            response = [math.log(a / r) if family == "lognormal" else (a - r) / r for a, r in pairs]
            cells.setdefault((subject, environment), []).append((response[0], response[1]))
    assert list(zip(reduced.cells["subject"], reduced.cells["environment"], strict=True)) == list(
        cells
    )
    for row, pairs in zip(reduced.cells.to_dict("records"), cells.values(), strict=True):
        (mean_k, ks, n), (mean_b, bs, _) = exact(p[0] for p in pairs), exact(p[1] for p in pairs)
        assert row["n"] == n
        # Rounding of n responses of size s: a few ulp of s, and of s² for the sums of squares.
        size = max(abs(float(v)) for v in (*ks, *bs))
        for name, value in (("mean_k", mean_k), ("mean_b", mean_b)):
            assert abs(Fraction(row[name]) - value) <= 8 * np.finfo(float).eps * size
        for name, (xs, mx), (ys, my) in (
            ("scatter_kk", (ks, mean_k), (ks, mean_k)),
            ("scatter_kb", (ks, mean_k), (bs, mean_b)),
            ("scatter_bb", (bs, mean_b), (bs, mean_b)),
        ):
            scatter = sum((x - mx) * (y - my) for x, y in zip(xs, ys, strict=True))
            assert abs(Fraction(row[name]) - scatter) <= 8 * n * np.finfo(float).eps * size**2


@pytest.mark.usefixtures("blocks")
def test_small_and_large_files_reduce_together(tmp_path, monkeypatch):
    records = rows()
    write(tmp_path / "a.csv", records[:360])
    quoted = [[f'"{cell}"' for cell in record] for record in records[360:]]
    write(tmp_path / "b.csv", quoted)
    write(tmp_path / "all.csv.txt", records)
    parts = reduce_sessions(tmp_path / "a.csv", tmp_path / "b.csv")
    one = reduce_sessions(tmp_path / "all.csv.txt")
    pd.testing.assert_frame_equal(parts.cells, one.cells, rtol=1e-12)
    assert parts.references.equals(one.references)
    assert parts.counts["observations"] == one.counts["observations"] == len(records)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize(
    ("cell", "value", "error", "message"),
    [
        (6, "-1.5", RefusalError, "no response in the family 'lognormal'"),
        (5, "1", UsageError, "trial 1 is already in "),
        (5, "-1", UsageError, "trial numbers are negative or too large"),
        (5, str(2**40), UsageError, "trial numbers are negative or too large"),
        (3, "16.0", UsageError, " in an earlier row."),
        (6, "x", UsageError, "not a number"),
    ],
)
def test_reduction_refuses(tmp_path, cell, value, error, message):
    records = rows()
    records[200][cell] = value
    with pytest.raises(error) as caught:
        reduce_sessions(write(tmp_path / "f.csv", records))
    assert message in str(caught.value)
    # Of two rows for one trial the second is named.
    assert caught.value.row == (203 if "already" in message else 202)


@pytest.mark.usefixtures("blocks")
def test_a_trial_that_stands_twice_far_apart_is_found(tmp_path):
    records = rows()
    again = [*records[3][:6], "15.5", "0.7"]
    with pytest.raises(
        UsageError, match=r"environment 'VE0', trial 3 is already in an earlier row\."
    ) as caught:
        reduce_sessions(write(tmp_path / "f.csv", [*records, again]))
    assert caught.value.row == len(records) + 2


def test_what_cannot_be_reduced(tmp_path):
    summary = tmp_path / "s.csv"
    summary.write_text("environment,parameter,reference,lower,upper,n,level\na,k,1,1,2,10,0.99\n")
    with pytest.raises(UsageError, match="a published summary is not reduced"):
        reduce_sessions(summary)
    with pytest.raises(UsageError, match="family is"):
        reduce_sessions(summary, family="log")
    with pytest.raises(UsageError, match="no file was given"):
        reduce_sessions()
    write(tmp_path / "k.csv", [["1", "a", "10", "11"]], header="subject,environment,k_ref,k_adj")
    write(tmp_path / "kb.csv", rows())
    with pytest.raises(UsageError, match="do not have the same parameters"):
        reduce_sessions(tmp_path / "k.csv", tmp_path / "kb.csv")


def told(read, *args, **kwargs):
    """What a reader gives: its notices, or the first of what it refuses."""
    try:
        return {typical(notice.text) for notice in read(*args, **kwargs).notices}
    except (UsageError, RefusalError) as error:
        return isinstance(error, UsageError), typical(error.message)


def typical(text):
    """Without the ratio: the median over cells is not quite that over trials."""
    return re.sub(r"is \S+ times", "is … times", text)


def one_file_each(tmp_path, records):
    by_subject = {}
    for record in records:
        by_subject.setdefault(record[0], []).append(record)
    return [write(tmp_path / f"{name}.csv", own) for name, own in by_subject.items()]


@pytest.mark.parametrize("streamed", [False, True])
@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize(
    "kind",
    [
        "units",
        "declared units",
        "units of one column declared",
        "units of the scene",
        "one far off",
        "never named",
        "one parameter",
        "two visits",
    ],
)
def test_what_the_reader_checks_over_a_study(tmp_path, monkeypatch, kind, several, streamed):
    if streamed:
        monkeypatch.setattr(files, "BLOCK", 300)
        monkeypatch.setattr(grids, "_HEAD", 500)
    records, tables = rows(subjects=3, trials=4), {}
    if "two visits" in kind:
        records = [[r[0], "2", *r[2:]] if r[0] != "000" and float(r[5]) % 2 else r for r in records]
    if "units" in kind:
        records = [[*r[:6], repr(1200 * float(r[6])), r[7]] for r in records]
        declared = {"declared units": ("k_adj", "k_ref"), "units": ()}.get(kind, ("k_adj",))
        tables["columns"] = {column: {"name": column, "unit": "N/m"} for column in declared}
    if kind == "units of the scene":
        tables["environments"] = {r[2]: {"k_ref": float(r[3])} for r in records}
    if kind == "one far off":
        records = [[*r[:6], repr(200 * float(r[6])), r[7]] if r[0] == "001" else r for r in records]
    if kind == "never named":
        tables["environments"] = {"VE9": {"k_ref": 1.0, "b_ref": 1.0}}
    if kind == "one parameter":
        records = [[*r[:4], "", *r[5:7], ""] if r[2] == "VE1" else r for r in records]
    paths = one_file_each(tmp_path, records) if several else [write(tmp_path / "all.csv", records)]
    options = ReadOptions.from_mapping(tables)
    assert told(reduce_sessions, *paths, scene=options) == told(
        read_sessions, *paths, scene=options
    )
    if kind in ("one far off", "one parameter"):
        sessions, reduced = (
            read_sessions(*paths, scene=options),
            reduce_sessions(*paths, scene=options),
        )
        table = sessions.table[sessions.table[["k_adj", "b_adj"]].notna().all(axis=1)]
        counted = table.groupby(["subject", "environment"], sort=False).size().reset_index(name="n")
        held = reduced.cells[reduced.cells["n"] > 0].reset_index(drop=True)
        pd.testing.assert_frame_equal(
            held[["subject", "environment", "n"]], counted, check_dtype=False
        )
        assert (
            reduced.cells[reduced.cells["n"] == 0]
            .filter(regex="mean|scatter")
            .isna()
            .all(axis=None)
        )
        for what in sessions.counts.keys() - {"rows without k", "rows without b"}:
            assert reduced.counts.get(what) == sessions.counts.get(what)


@pytest.mark.usefixtures("blocks")
def test_blocks_warn_of_what_the_first_trials_show(tmp_path):
    """A slip, a control left alone and a cell not tried, in two groups."""
    records = [[*r, "old" if r[0] < "002" else "young"] for r in rows(trials=15)]
    records[1 * 45][6] = "1e9"
    records = [
        [*r[:7], r[4], r[8]] if r[0] == "003" else r
        for r in records
        if (r[0], r[2]) != ("002", "VE1")
    ]
    reduced = reduce_sessions(write(tmp_path / "f.csv", records, header=f"{HEAD},group"))
    texts = [notice.text for notice in reduced.warnings]
    assert [text.partition(" ")[0] for text in texts] == ["1", "subject", "1", "2"]
    assert "'001 at VE0: 1e+09, median " in texts[0]
    assert (reduced.warnings[0].row, reduced.warnings[0].file) == (47, str(tmp_path / "f.csv"))
    assert texts[1].startswith("subject '003' left b at the reference in every trial")
    assert texts[2] == "1 cell has no trial: '002 at VE1'"
    assert texts[3].startswith("2 groups ('old' 2 subjects, 'young' 4 subjects) are pooled")


def test_a_file_in_other_units_is_refused_by_blocks_too(tmp_path):
    records = [
        [*r[:6], repr(float(r[6]) / 1000), r[7]] if r[0] == "001" else r for r in rows(subjects=4)
    ]
    paths = one_file_each(tmp_path, records)
    for read in (read_sessions, reduce_sessions):
        with pytest.raises(
            UsageError, match="units of the file seem to differ by a thousand"
        ) as caught:
            read(*paths)
        assert caught.value.file == str(tmp_path / "001.csv")


def test_folders_of_results_and_other_files_are_noticed(tmp_path):
    one_file_each(tmp_path, rows(subjects=2))
    (tmp_path / "notes.md").write_text("to do")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "fit.sha256").write_text("")
    assert told(reduce_sessions, tmp_path) == told(read_sessions, tmp_path) != set()


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize("family", ["lognormal", "normal"])
@pytest.mark.parametrize("value", ["0", "-15.0"])
def test_references_that_have_no_ratio(tmp_path, family, value):
    records = [[*r[:3], value if r[2] == "VE0" else r[3], *r[4:]] for r in rows()]
    with pytest.raises(RefusalError, match="no response in the family") as caught:
        reduce_sessions(write(tmp_path / "f.csv", records), family=family)
    assert caught.value.row == 2
    assert "references are positive" in str(caught.value)


@pytest.mark.usefixtures("blocks")
def test_a_reference_that_comes_too_late(tmp_path):
    records = [
        [*r[:3], "" if at < 200 and r[2] == "VE0" else r[3], *r[4:]] for at, r in enumerate(rows())
    ]
    with pytest.raises(UsageError, match=r"environment 'VE0' has no reference\..*\[environments\."):
        reduce_sessions(write(tmp_path / "f.csv", records))
