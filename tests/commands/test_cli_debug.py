import pytest

from percept.cli import main
from percept.errors import UsageError


@pytest.mark.parametrize("before", [True, False], ids=["before the command", "after it"])
def test_debug_shows_the_traceback(before):
    command = ["validate", "nowhere.csv", "--scene", "nowhere.toml"]
    with pytest.raises(UsageError, match="nowhere"):
        main(["--debug", *command] if before else [*command, "--debug"])


def test_without_debug_an_error_is_one_line(capsys):
    assert main(["validate", "nowhere.csv", "--scene", "nowhere.toml"]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert message.startswith("percept: nowhere.toml")
