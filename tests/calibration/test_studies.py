import pytest

from percept.calibration.studies import computed
from percept.errors import RefusalError
from percept.workers import InProcess


def test_an_error_is_said_when_all_others_are_done():
    found = []

    def run():
        for index, value in computed(lambda index: 6 // index, [3, 0, 2], InProcess(), name="a"):
            found.append((index, value))

    message = r"1 studies ended in an error; study 0: ZeroDivisionError: .*the same run again tries these"
    with pytest.raises(RefusalError, match=message) as caught:
        run()
    assert found == [(3, 2), (2, 3)]
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
