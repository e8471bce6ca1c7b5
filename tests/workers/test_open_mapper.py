import sys

import pytest

from percept.cli import build_parser
from percept.commands.analysis import open_mapper
from percept.errors import UsageError
from percept.workers import connected, cores, in_process
from tests.workers.clusters import QUIET

pytestmark = QUIET


def test_arguments_are_taken_when_the_result_before_is_handed_back():
    seen = []

    def numbers():
        for number in range(3):
            seen.append(f"take {number}")
            yield number

    for number, result in in_process(lambda number: number**2, numbers()):
        seen.append(f"{number}: {result}")
    assert seen == ["take 0", "0: 0", "take 1", "1: 1", "take 2", "2: 4"]


def test_an_interruption_is_no_result():
    def interrupted(x):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        next(in_process(interrupted, [1]))


def test_one_worker_is_this_process_and_any_number_has_a_core_each():
    with opened("--workers", "1") as mapper:
        assert mapper is in_process
    with opened() as mapper:
        assert (mapper is in_process) == (cores() == 1)


def opened(*words):
    return open_mapper(
        build_parser(["calibrate"]).parse_args(["calibrate", "sessions.csv", *words])
    )


def test_without_dask_a_scheduler_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(
        UsageError, match=r"not installed.*percept-haptics\[cluster\], or leave --scheduler out"
    ):
        opened("--scheduler", "tcp://127.0.0.1:1").__enter__()


def test_no_scheduler_at_the_address_is_said():
    pytest.importorskip("distributed", reason="needs the extra percept-haptics[cluster]")
    with pytest.raises(
        UsageError, match=r"tcp://127.0.0.1:1.*no scheduler answers.*dask worker ADDRESS"
    ):
        connected("tcp://127.0.0.1:1", patience=0.5).__enter__()
