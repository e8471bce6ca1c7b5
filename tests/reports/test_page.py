"""Pages in Markdown, the command that makes them, and what processes cost."""

import pytest

from percept.errors import RefusalError
from reports.__main__ import PAGES, main
from reports.measure import in_a_process, run_python
from reports.page import Page


def doubled(value):
    return [value * 2, "text"]


def test_tables_round_and_escape():
    page = Page("Title", "First.")
    page.table(["a", "b|c"], [[1 / 3, "x|y"], [None, 3], [7, (0.5, "z")]])
    assert page.text == (
        "# Title\n\nFirst.\n\n| a | b|c |\n|---|---|\n| 0.3333 | x\\|y |\n|  | 3 |\n"
        "| 7 | 0.5, z |\n"
    )


def test_a_page_says_what_it_was_made_by(tmp_path, capsys):
    out = tmp_path / "new"
    assert main(["equivalence", "--studies", "50", "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{out / 'equivalence.md'}\n"
    text = (out / "equivalence.md").read_text(encoding="utf-8")
    assert text.startswith("# Within one JND?\n\nAll 50 studies of a row are simulated")
    assert f" by `python -m reports equivalence --studies 50 --out {out}`" in text
    assert text.splitlines()[-1].startswith("Made on ")
    assert " s on " in text.splitlines()[-1]


def test_what_percept_refuses_ends_the_command(tmp_path, capsys):
    assert main(["designs", "--rows", "7x7x7", "--out", str(tmp_path)]) == 2
    assert "'7x7x7': no such design; there are 2x4x1, 4x60x1" in capsys.readouterr().err
    assert main(["samplers", "--engines", "stan", "--out", str(tmp_path)]) == 2
    assert "no such engine; they are percept, emcee, nutpie" in capsys.readouterr().err


@pytest.mark.parametrize("name", PAGES)
def test_every_page_lists_its_options(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    assert "--out" in capsys.readouterr().out


def test_work_costs_more_than_none():
    _, light = run_python("-c", "pass")
    output, heavy = run_python("-c", "x = bytearray(200_000_000); print(sum(range(6_000_000)))")
    assert output == f"{sum(range(6_000_000))}\n"
    assert heavy.processor > light.processor
    assert heavy.memory > light.memory + 150.0
    assert heavy.wall > 0.5 * heavy.processor


def test_a_process_that_fails_or_takes_too_long_is_named():
    with pytest.raises(RefusalError, match="-c import no_such failed: ModuleNotFoundError"):
        run_python("-c", "import no_such")
    with pytest.raises(RefusalError, match=r"not finished after 0\.2 s"):
        run_python("-c", "import time; time.sleep(60)", timeout=0.2)


def test_a_function_is_called_in_a_process_of_its_own():
    found, cost = in_a_process(doubled, 21)
    assert found == [42, "text"]
    assert cost.memory > 5.0
