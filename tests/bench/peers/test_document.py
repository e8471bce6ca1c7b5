"""From measurements to times at given errors, ratios, promises and the page."""

import dataclasses
import html.parser
import json

import numpy as np
import pytest

from percept.bench.growth import Growth
from percept.bench.peers.document import PAGE, build_document, reached, write_benchmark
from percept.bench.peers.processes import COMMANDS, Measured, Startup, Whole, comparisons
from percept.bench.peers.reference import LongRun, Reference


def row(name, size, warm, error, *, how="draws", cold_more=10.0, steps=14.0):
    return Measured(
        engine=name, how=how, size=size, repeats=3, warm=warm, cold=warm + cold_more, warm_range=(warm, warm),
        processor=2.0 * warm, error=error, error_range=(error, error), effective_per_second=100.0 / warm,
        effective_per_processor_second=50.0 / warm, agreement=1.0, notes={"autocorrelation_time": steps},
    )  # fmt: skip


OURS = [row("percept", 0.1, 1.0, 0.02, how="mixture", cold_more=1.0),
        row("percept", 0.01, 4.0, 0.01, how="mixture", cold_more=1.0)]  # fmt: skip
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
        Whole(name, name, (value,) * 5, value, value) for name, value in zip(COMMANDS, seconds, strict=True)
    ]


def reference(count=10):
    value = np.stack([np.stack([np.full(count, -1.0), np.full(count, 1.0)])] * 3)
    run = LongRun(value, np.full(value.shape, 1e-3), 1e6, 30, 1.0)
    return Reference(
        run, run, tuple(("k", f"VE{j}") for j in range(count)), "x" * 64, "percept bench reference"
    )


def document(measured, seconds=(10.0, 4.0, 15.0, 5.0, 5.0, 2.0), growth=()):
    startups = [Startup(name, (9.0, 10.0, 11.0), 12.0) for name in dict.fromkeys(r.engine for r in measured)]
    return build_document(
        startups, measured, whole(seconds), reference(), growth=growth,
        command="percept bench peers --out DIR", loads=(0.1, 2.0), seconds=60.0,
    )  # fmt: skip


def test_promised_ratios_of_whole_commands():
    found = {(one.command, one.against): one for one in comparisons(whole((10.0, 4.0, 46.0, 5.0, 5.0, 2.0)))}
    assert found["percept report", "import pymc"].ratio == pytest.approx(4.6)
    assert not found["percept report", "import pymc"].kept
    assert found["percept fit", "import pymc"].kept
    assert found["percept fit, 2 %", "import what percept fit needs"].ratio == pytest.approx(1.25)


def test_rounds_in_which_the_machine_is_slow_cancel():
    names = dict.fromkeys(COMMANDS, (1.0, 1.0, 3.0, 3.0, 1.0)) | {"percept fit": (2.0, 2.0, 6.0, 6.0, 6.0)}
    runs = [Whole(name, name, seconds, sorted(seconds)[2], 1.0) for name, seconds in names.items()]
    found = {one.command: one.ratio for one in comparisons(runs)}
    # The ratio of the medians would be 6.
    assert found["percept fit"] == 2.0


def test_losses_are_said():
    slow = [dataclasses.replace(one, warm=100.0 * one.warm, cold=100.0 * one.cold) for one in OURS]
    found = document([*slow, *NUTPIE], (10.0, 4.0, 46.0, 5.0, 5.0, 2.0))["losses"]
    assert "nutpie, written plainly (draws) reaches 10.0% warm in 0.30 times percept’s time." in found
    assert "percept report takes 4.60 times as long as import pymc; 4.5 is promised." in found
    quick = [dataclasses.replace(one, warm=1e-3 * one.warm, cold=1e-3 * one.cold) for one in OURS]
    quick = [dataclasses.replace(one, effective_per_second=1e5) for one in quick]
    assert document([*quick, *NUTPIE])["losses"] == []


def test_promises_against_nutpie():
    promises = document([*OURS, *NUTPIE])["promises"]
    usual, best, time, steps = (one["value"] for one in promises)
    assert usual == pytest.approx(100.0 / (100.0 / 30.0))
    assert best == pytest.approx(100.0 / (100.0 / 8.0))
    assert time == pytest.approx(30.0 * 100.0 / 4.0)
    assert steps == 14.0
    assert document([*OURS, *NUTPIE])["losses"] == [
        "Effective draws per second over nutpie’s, 4 × 1000 draws: 30; 1000 is the aim.",
        "Effective draws per second over nutpie’s at its best, 4 × 250 draws: 8; 1000 is the aim.",
        "Nutpie’s sampling time to an error of 1 %, over percept’s: 750; 5000 is the aim.",
    ]
    assert document(OURS)["promises"] == []


def test_growth_is_shown_and_said_where_it_is_more_than_promised(tmp_path):
    rows = [
        Growth("density call", "trial rows", 5_000_000, 0.0123, ratio, 0.9, 1.2, promised)
        for ratio, promised in ((1.04, 1.1), (1.16, 1.1), (30.0, None))
    ]
    made = document([*OURS, *NUTPIE], growth=rows)
    said = (
        "With trial rows a density call at 5000000 takes 1.16 times as long as at the least; 1.1 is promised."
    )
    assert [line for line in made["losses"] if "density call" in line] == [said]
    text = write_benchmark(made, tmp_path / "out", date="2024-05-01").read_text(encoding="utf-8")
    assert 'id="growth"' in text
    # The list of losses, the caption and three rows.
    assert text.count("density call") == 5
    bare = write_benchmark(document([*OURS, *NUTPIE]), tmp_path / "bare").read_text(encoding="utf-8")
    assert 'id="growth"' in bare
    assert "density call" not in bare


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
    made = document([*OURS, *NUTPIE, row("percept", 0.1, 1.0, 0.05)], (10.0, 4.0, 46.0, 5.0, 5.0, 2.0))
    page = write_benchmark(made, tmp_path / "out", date="2024-05-01")
    text = page.read_text(encoding="utf-8")
    links = Links()
    links.feed(text)
    assert page.name == PAGE
    assert all(tag == "a" and (page.parent / value).is_file() for tag, value in links.outside)
    assert {"result", "ratios", "whole", "figure-time-warm", "figure-time-cold"} <= links.ids
    for said in (
        "percept bench peers --out DIR",
        "The machine was shared",
        "4.60 times as long as import pymc",
    ):
        assert said in text
    assert json.loads((tmp_path / "out" / "benchmark.json").read_text(encoding="utf-8")) == made
    svg = (tmp_path / "out" / "figures" / "time-warm.svg").read_text(encoding="utf-8")
    assert "time (s)" in svg
