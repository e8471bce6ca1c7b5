"""What an error says: where, what is wrong, and what to do next."""

import pickle

import pytest

from percept.errors import PerceptError, RefusalError, UsageError, printable


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ({}, "is wrong."),
        ({"file": "a.csv"}, "a.csv: is wrong."),
        (
            {"file": "a.csv", "row": 3, "column": "k_adj", "value": "x"},
            "a.csv:3, column 'k_adj', value 'x': ",
        ),
        (
            {"file": "s.toml", "key": "inference.level", "value": 99},
            "s.toml, inference.level = 99: is wrong.",
        ),
        ({"key": "device"}, "device: is wrong."),
        ({"value": 0}, "value 0: is wrong."),
        ({"column": "b", "hint": "Mend it."}, "column 'b': is wrong. Mend it."),
    ],
)
def test_the_place_comes_first_and_the_hint_last(place: dict[str, object], text: str) -> None:
    assert str(UsageError("is wrong.", **place)).startswith(text)


def test_exit_codes_tell_wrong_usage_from_a_refusal() -> None:
    assert (UsageError("x").exit_code, RefusalError("x").exit_code) == (2, 1)
    assert issubclass(PerceptError, ValueError)


def test_an_error_of_another_process_says_the_same() -> None:
    error = RefusalError(
        "is wrong.", file="a.csv", row=3, column="k_adj", value=-1.0, hint="Mend it."
    )
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is RefusalError
    assert str(again) == str(error)


def test_control_and_bidirectional_characters_are_escaped_and_narrow_spaces_are_not() -> None:
    assert printable("24\u202f%\u00a0of") == "24\u202f%\u00a0of"
    assert printable("a\x1b[2J\x9b\u202eb\n") == r"a\x1b[2J\x9b\u202eb\n"
