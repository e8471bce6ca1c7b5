"""A notebook shows every record with its fields and numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pandas as pd
import pytest

from percept import Scene, Study, haptics, inference, read_sessions
from percept.haptics import Device, Loop
from percept.html import NotebookRecord, fields_html
from percept.planning import plan_mean
from tests import DATASETS

COUPLING = haptics.Coupling(stiffness=50e3, damping=100.0)
DEVICE = haptics.Device(mass=1.0, damping=5.0)
X = [9.0, 11.0, 10.5, 8.0, 12.0]


@pytest.fixture(scope="module")
def study():
    scene = Scene.load(DATASETS / "hbfd.toml").with_inference(method="classical")
    return Study(read_sessions(DATASETS / "hbfd_sessions.csv"), scene)


@pytest.mark.parametrize(
    "made",
    [
        lambda _: haptics.required_damping(Loop(Device(1.0, 5.0), 1e-3), COUPLING),
        lambda _: haptics.absolute_stability(Loop(DEVICE, 1e-3), COUPLING),
        lambda _: inference.t_interval(X),
        lambda _: inference.Moments.from_values(X),
        lambda _: plan_mean(0.1, sd=0.2),
        lambda study: study.band,
        lambda study: study.coupling,
        lambda study: study.other_devices,
        lambda study: study.scene,
    ],
)
def test_records(study, made):
    record = made(study)
    page = record._repr_html_()
    assert page.startswith("<table>")
    assert page.endswith("</table>")
    assert "object at 0x" not in page
    if isinstance(record, NotebookRecord):
        for field in dataclasses.fields(record):
            assert f"<th>{field.name}</th>" in page


def test_numbers_are_rounded_text_is_escaped_and_arrays_are_told_by_their_shape():
    page = fields_html(
        {
            "<name>": "a & <b>",
            "one": np.float64(1.0) / 3.0,
            "none": None,
            "flag": True,
            "many": np.zeros((3, 400)),
            "long": list(range(9)),
            "table": pd.DataFrame({"x": ["<i>"]}),
        },
        caption="it's <so>",
    )
    assert "<caption>it&#x27;s &lt;so&gt;</caption>" in page
    assert "<tr><th>&lt;name&gt;</th><td>a &amp; &lt;b&gt;</td></tr>" in page
    cells = {"one": "0.333333", "none": "–", "flag": "True", "long": "9 values"}
    cells["many"] = "array of shape 3 × 400"
    for name, text in cells.items():
        assert f"<tr><th>{name}</th><td>{text}</td></tr>" in page
    assert "&lt;i&gt;" in page
    assert "<i>" not in page


def test_records_in_a_line_and_tables_shown_as_text(study):
    printed = repr(study.boundaries[0])
    assert printed.startswith("Boundary\n  environment: VE1\n")
    assert f"  omega: array of shape {study.boundaries[0].omega.size}" in printed
    with pd.option_context("display.notebook_repr_html", False):
        assert "<td>None</td>" not in fields_html({"table": pd.DataFrame({"x": [1.0]})})
