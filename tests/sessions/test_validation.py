"""What `percept validate` is told."""

from __future__ import annotations

import json
import tomllib

import pytest

from percept.errors import UsageError
from percept.sessions import ReadOptions, format_validation, propose_columns, read_sessions, validate
from tests.sessions.dialects import WRITERS, example

HEAD = "subject,environment,k_ref,k_adj\n"


def test_what_was_read(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "001,a,10,11\n1,a,10,12\n1,b,10,\n")
    record = validate(file)
    text = format_validation(record)
    assert record.exit_code == 0
    assert f"{file}: 3 rows, sha256 {record.sources[0].sha256}" in text
    assert "notice: subjects '001', '1' look alike and are kept apart" in text
    assert f"left out: {file}:4: subject 1, environment b: no adjustment" in text
    assert text.endswith("read without problems")
    parsed = json.loads(record.to_json())
    assert parsed["counts"]["observations"] == 2
    assert parsed["exclusions"][0]["row"] == 4


def test_problems_have_places(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "1,a,10,x\n2,a,10,y\n")
    record = validate(file)
    assert record.exit_code == 2
    lines = format_validation(record).splitlines()
    assert lines[0].startswith(f"{file}:2:k_adj: not a number. (found 'x')")
    assert lines[-1] == "2 problems"
    problem = json.loads(record.to_json())["problems"][1]
    assert (problem["row"], problem["column"], problem["value"]) == (3, "k_adj", "y")


def test_one_subject_is_no_study(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text(HEAD + "1,a,10,11\n")
    record = validate(file)
    assert record.exit_code == 1
    assert "there is one subject" in format_validation(record)


@pytest.mark.parametrize("name", ["psychopy", "opensesame", "gorilla", "e-prime export"])
def test_a_proposed_map_reads_the_file_it_was_made_from(tmp_path, name):
    writer = WRITERS[name]
    file = tmp_path / "f.csv"
    file.write_bytes(next(iter(writer.write(example()).values())))
    proposed = tomllib.loads(propose_columns(file).text)
    options = ReadOptions.from_mapping({**proposed, "sessions": writer.tables.get("sessions", {})})
    assert read_sessions(file, options=options).table.equals(
        read_sessions(file, options=writer.options).table
    )


def test_an_unknown_file_gets_lines_to_fill_in(tmp_path):
    file = tmp_path / "f.csv"
    file.write_text('who,"what ""it"" was",how\n1,2,3\n')
    proposal = propose_columns(file)
    text = proposal.text
    assert tomllib.loads(text) == {"columns": {}}
    assert proposal.guessed == ()
    assert proposal.missing == ("subject", "environment", "NAME_ref", "NAME_adj")
    assert '# subject = ""' in text
    assert r'# not used: "what \"it\" was": 1 different: 2' in text
    file.write_text("subj,sub,k_adj\n1,2,3\n")
    assert "# row 1, column" not in propose_columns(file).text
    assert "'subj', 'sub' could each be subject." in propose_columns(file).text
    file.write_text("nothing")
    with pytest.raises(UsageError, match="this is not a table"):
        propose_columns(file)
