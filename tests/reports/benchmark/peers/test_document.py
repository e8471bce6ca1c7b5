"""From measurements to times at given errors, ratios, promises and the page."""

import dataclasses
import html.parser
import json

import numpy as np
import pytest

from percept.provenance import made_by
from percept.results.plain import plain
from reports.benchmark.measure import machine
from reports.benchmark.peers.document import build_document, reached
from reports.benchmark.peers.processes import COMMANDS, Measured, Whole, comparisons
from reports.benchmark.peers.reference import Reference
from reports.benchmark.peers.run import PAGE, write_benchmark


def row(name, size, warm, error, *, cold_more=10.0, steps=14.0):
    return Measured(
        study="published",
        engine=name,
        size=size,
        repeats=3,
        warm=warm,
        cold=warm + cold_more,
        warm_range=(warm, warm),
        processor=2.0 * warm,
        error=error,
        error_range=(error, error),
        effective_per_second=100.0 / warm,
        effective_per_processor_second=50.0 / warm,
        agreement=1.0,
        notes={"autocorrelation_time": steps},
    )


OURS = [row("percept", 0.1, 1.0, 0.02, cold_more=1.0),
        row("percept", 0.01, 4.0, 0.01, cold_more=1.0)]  # fmt: skip
NUTPIE = [row("nutpie", 250, 8.0, 0.2), row("nutpie", 1000, 30.0, 0.1)]


def test_times_to_an_error_are_measured_where_they_can_be():
    times = {(one.engine, one.level): one for one in reached([*OURS, *NUTPIE], (0.1, 0.02, 0.005))}
    # Measured: the fastest run that was accurate enough.
    ours = times["percept", 0.1]
    assert (ours.warm, ours.cold, ours.processor, ours.extrapolated) == (1.0, 2.0, 2.0, False)
    assert (times["nutpie", 0.1].warm, times["nutpie", 0.1].extrapolated) == (30.0, False)
    # Beyond: time over error squared from the most accurate run; the start-up is paid once.
    assert times["percept", 0.005].warm == pytest.approx(16.0)
    assert times["percept", 0.005].cold == pytest.approx(17.0)
    beyond = times["nutpie", 0.02]
    assert beyond.extrapolated
    assert (beyond.warm, beyond.cold) == (pytest.approx(750.0), pytest.approx(760.0))
    assert beyond.warm_ratio == pytest.approx(750.0)
    assert beyond.cold_ratio == pytest.approx(380.0)


def whole(seconds):
    return [
        Whole(name, name, (value,) * 5, value, value)
        for name, value in zip(COMMANDS, seconds, strict=True)
    ]


def reference(count=10):
    value = np.stack([np.stack([np.full(count, -1.0), np.full(count, 1.0)])] * 3)
    return Reference(value, np.full(value.shape, 1e-3), 1e6, 30, 1.0)


def document(measured, seconds=(10.0, 4.0, 15.0, 14.0, 5.0, 5.0, 2.0)):
    return build_document(
        measured, whole(seconds), {"published": reference()},
        made=made_by("python -m reports.benchmark peers --out DIR"), at=machine((0.1, 2.0), 60.0),
    )  # fmt: skip


def test_promised_ratios_of_whole_commands():
    seconds = 10.0, 4.0, 46.0, 31.0, 5.0, 5.0, 2.0
    found = {(one.command, one.against): one for one in comparisons(whole(seconds))}
    assert found["percept report", "import pymc"].ratio == pytest.approx(4.6)
    assert not found["percept report", "import pymc"].kept
    # Without its checks a report has less time: 3.1 of 3.2 times.
    assert found["percept report, no checks", "import pymc"].kept
    assert found["percept fit", "import pymc"].kept
    assert found["percept fit, 2 %", "import what percept fit needs"].ratio == pytest.approx(1.25)


def test_rounds_in_which_the_machine_is_slow_cancel():
    names = dict.fromkeys(COMMANDS, (1.0, 1.0, 3.0, 3.0, 1.0)) | {
        "percept fit": (2.0, 2.0, 6.0, 6.0, 6.0)
    }
    runs = [Whole(name, name, seconds, sorted(seconds)[2], 1.0) for name, seconds in names.items()]
    found = {one.command: one.ratio for one in comparisons(runs)}
    # The ratio of the medians would be 6.
    assert found["percept fit"] == 2.0


def test_losses_are_said():
    slow = [dataclasses.replace(one, warm=100.0 * one.warm, cold=100.0 * one.cold) for one in OURS]
    found = document([*slow, *NUTPIE], (10.0, 4.0, 46.0, 31.0, 5.0, 5.0, 2.0)).losses
    assert (
        "published: nutpie, written plainly reaches 10.0% warm in 0.30 times percept’s time."
        in found
    )
    assert (
        "percept report takes 4.60 times the wall time and 4.60 times the processor time of import"
        " pymc; 4.5 is promised." in found
    )
    quick = [dataclasses.replace(one, warm=1e-3 * one.warm, cold=1e-3 * one.cold) for one in OURS]
    quick = [dataclasses.replace(one, effective_per_second=1e5) for one in quick]
    assert document([*quick, *NUTPIE]).losses == []


def test_promises_against_nutpie():
    promises = document([*OURS, *NUTPIE]).aims
    usual, time = (one.value for one in promises)
    assert usual == pytest.approx(100.0 / (100.0 / 30.0))
    assert time == pytest.approx(30.0 * 100.0 / 4.0)
    assert document([*OURS, *NUTPIE]).losses == [
        "Effective draws per second over nutpie’s, 4 × 1000 draws: 30; 1000 is the aim.",
        "Nutpie’s sampling time to an error of 1 %, over percept’s: 750; 5000 is the aim.",
    ]
    assert document(OURS).aims == []


def test_a_promise_is_kept_in_wall_and_processor_time():
    runs = [
        Whole(name, name, (1.0,) * 5, 1.0, 9.0 if name == "percept fit" else 1.0)
        for name in COMMANDS
    ]
    found = {one.command: one for one in comparisons(runs)}
    assert (found["percept fit"].ratio, found["percept fit"].kept) == (1.0, False)
    assert found["percept report"].kept


class Links(html.parser.HTMLParser):
    def __init__(self):
        super().__init__()
        self.outside, self.ids = [], set()

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name in ("src", "href", "xlink:href") and not (value or "").startswith("#"):
                self.outside.append((tag, value))
            if name == "id":
                self.ids.add(value)


def test_page_holds_everything_and_asks_for_nothing(tmp_path):
    made = document(
        [*OURS, *NUTPIE, row("percept", 0.1, 1.0, 0.05)], (10.0, 4.0, 46.0, 31.0, 5.0, 5.0, 2.0)
    )
    write_benchmark(made, tmp_path / "out")
    page = tmp_path / "out" / PAGE
    text = page.read_text(encoding="utf-8")
    links = Links()
    links.feed(text)
    assert all(tag == "a" and (page.parent / value).is_file() for tag, value in links.outside)
    assert {"result", "ratios", "whole", "figure-time-published"} <= links.ids
    for said in (
        "python -m reports.benchmark peers --out DIR",
        "The machine was shared",
        "4.60 times the wall time",
    ):
        assert said in text
    written = json.loads((tmp_path / "out" / "benchmark.json").read_text(encoding="utf-8"))
    assert written == plain(made)
    svg = (tmp_path / "out" / "figures" / "time-published.svg").read_text(encoding="utf-8")
    assert "time (s)" in svg
