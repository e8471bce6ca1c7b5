"""The stability figure draws what it is given, marks what binds, and refuses what it cannot draw."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from percept.errors import UsageError
from percept.haptics import (
    Coupling,
    Device,
    Mode,
    absolute_stability,
    coupling_admittance,
    coupling_bound,
)
from percept.report.figures.stability import draw_stability

T = 1e-3
OMEGA = np.geomspace(1.0, np.pi / T, 400)
DEVICE = Device(1.0, 16.0, (Mode(0.08, 2e4, 1.5), Mode(0.03, 7e4, 0.8)))
COUPLINGS = {"110 kN/m": Coupling(110e3, 100.0), "50 kN/m": Coupling(50e3, 100.0)}


@pytest.fixture
def ax():
    return Figure().subplots()


def curves():
    bound = coupling_bound(OMEGA, DEVICE, T)
    return bound, {label: coupling_admittance(OMEGA, c, T).real for label, c in COUPLINGS.items()}


def by_gid(ax, gid):
    return [line for line in ax.lines if line.get_gid() == gid]


def test_bound_and_couplings_are_drawn_as_given(ax):
    bound, reached = curves()
    draw_stability(ax, OMEGA, bound, reached)
    (line,) = by_gid(ax, "bound")
    # At Nyquist the bound is zero, which a log axis cannot show.
    np.testing.assert_array_equal(line.get_ydata()[:-1], bound[:-1])
    assert np.isnan(line.get_ydata()[-1])
    for label, values in reached.items():
        (line,) = by_gid(ax, f"coupling:{label}")
        np.testing.assert_array_equal(line.get_ydata(), values)
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert "rad/s" in ax.get_xlabel()
    assert not [line for line in ax.lines if str(line.get_gid()).startswith("binding")]


def test_binding_frequency_is_marked_and_named(ax):
    bound, reached = curves()
    verdicts = {label: absolute_stability(DEVICE, c, T) for label, c in COUPLINGS.items()}
    draw_stability(ax, OMEGA, bound, reached, binding={k: v.binding_omega for k, v in verdicts.items()})
    dots = [dot for label in verdicts for dot in by_gid(ax, f"binding:{label}")]
    assert [dot.get_xdata()[0] for dot in dots] == [v.binding_omega for v in verdicts.values()]
    for dot, coupling in zip(dots, COUPLINGS.values(), strict=True):
        expected = coupling_admittance(dot.get_xdata()[0], coupling, T).real
        assert dot.get_ydata()[0] == pytest.approx(expected, rel=1e-3)
    texts = [text.get_text() for text in ax.get_legend().get_texts()]
    for text, (label, verdict) in zip(texts[1:], verdicts.items(), strict=True):
        assert text == f"{label}: {verdict.smallest_margin:.3g} × bound at {verdict.binding_omega:.4g} rad/s"


@pytest.mark.parametrize(
    ("omega", "change", "message"),
    [
        (OMEGA[1:], {}, "'bound' and omega differ in length"),
        (OMEGA - 1.0, {}, "positive and increasing"),
        (OMEGA[::-1], {}, "positive and increasing"),
        (OMEGA, {"binding": {"30 kN/m": 100.0}}, "names a coupling that is not drawn"),
        (OMEGA, {"binding": {"50 kN/m": 0.5}}, "outside the range drawn"),
    ],
)
def test_what_cannot_be_drawn_is_refused(ax, omega, change, message):
    bound, reached = curves()
    with pytest.raises(UsageError, match=message):
        draw_stability(ax, omega, bound, reached, **change)
