"""Devices found again in simulated logs, and what a log cannot tell."""

import dataclasses

import numpy as np
import pytest

from percept.errors import RefusalError, UsageError
from percept.identify.bootstrap import bootstrap_sds
from percept.identify.fit import climb, fit_device
from percept.identify.log import Response
from percept.identify.model import Terms
from percept.identify.posterior import sample_device
from percept.identify.result import Request, identify
from percept.identify.spectra import Periods, TimeLog, of_segments
from tests import LONG
from tests.identify.simulated import DEVICES, Recording, simulate

RECORDING = Recording()
#: Chance alone leaves this in one of a few hundred parameters.
MOST_SDS = 4.0


def fitted(terms, values, seed, *, position=False, recording=RECORDING):
    log = simulate(terms, values, np.random.default_rng(seed), recording, position=position)
    periods = Periods.of(log, recording.period, recording.band)
    return fit_device(periods.spectra(), terms), periods


@pytest.mark.parametrize("position", [False, True])
@pytest.mark.parametrize(
    ("terms", "values"),
    [
        *DEVICES.values(),
        (Terms(1, True, True, True), [1.0, 5.0, 300.0, 2e-3, 0.8, 0.2, 8e3, 2.0]),
        (Terms(modes=2), [1.0, 5.0, 0.2, 8e3, 2.0, 0.1, 2e4, 1.0]),
    ],
)
def test_every_parameter_is_found(terms, values, position):
    fit, _ = fitted(terms, values, 7, position=position)
    assert np.all(np.abs(fit.point - np.log(values)) < MOST_SDS * fit.sd)
    assert fit.fits
    assert fit.unidentified() == {}


def test_modes_come_in_the_order_of_their_resonances():
    values = [1.0, 5.0, 0.1, 2e4, 1.0, 0.2, 8e3, 2.0]
    fit, _ = fitted(Terms(modes=2), values, 7)
    assert fit.resonance(1) == pytest.approx(200.0, rel=0.01)
    assert fit.resonance(2) == pytest.approx(np.sqrt(2e5), rel=0.01)


def test_modes_in_a_new_order_take_their_priors_along():
    values = [1.0, 5.0, 0.1, 2e4, 1.0, 0.2, 8e3, 2.0]
    terms = Terms(modes=2)
    log = simulate(terms, values, np.random.default_rng(7), RECORDING)
    spectra = Periods.of(log, RECORDING.period, RECORDING.band).spectra()
    # Narrow priors that name the mode of the higher resonance first.
    priors = [
        dataclasses.replace(parameter, median=value, sd=0.1)
        for parameter, value in zip(terms.parameters, values, strict=True)
    ]
    fit = fit_device(spectra, terms, priors)
    assert fit.resonance(1) < fit.resonance(2)
    assert fit.names == [parameter.name for parameter in terms.parameters]
    medians = [parameter.median for parameter in fit.density.parameters]
    assert medians == [1.0, 5.0, 0.2, 8e3, 2.0, 0.1, 2e4, 1.0]
    # The point is a mode of the density that goes on to the sampler.
    around = fit.point + 3.0 * np.diag(fit.sd)
    assert np.all(fit.density(fit.point[None]) > fit.density(around))


def test_a_mode_above_the_band_is_not_identifiable():
    fit, _ = fitted(Terms(modes=1), [1.0, 5.0, 0.2, 0.2 * 2000.0**2, 2.0], 7)
    assert "mode 1 damping" in fit.unidentified()


def test_a_spring_below_its_resolution_is_not_identifiable():
    log = simulate(Terms(), [1.0, 5.0], np.random.default_rng(7), RECORDING)
    periods = Periods.of(log, RECORDING.period, RECORDING.band)
    fit = fit_device(periods.spectra(), Terms(spring=True))
    assert "factor of" in fit.unidentified()["stiffness"]


def test_a_device_that_does_not_fit_is_told():
    terms, values = DEVICES["one mode"]
    log = simulate(terms, values, np.random.default_rng(7), RECORDING)
    periods = Periods.of(log, RECORDING.period, RECORDING.band)
    fit = fit_device(periods.spectra(), Terms())
    assert not fit.fits
    assert fit.misfit > 10.0


def test_posterior_bootstrap_and_information_agree_where_the_log_tells_much():
    terms, values = DEVICES["rigid"]
    recording = Recording(periods=20)
    fit, periods = fitted(terms, values, 7, recording=recording)
    posterior = sample_device(fit)
    assert posterior.run.gate.passed
    sds = np.sqrt(np.diag(posterior.covariance))
    # The density is near normal; the sampler's errors are 2 % of an SD.
    assert np.abs(posterior.mean - fit.point).max() < 0.1 * fit.sd.max()
    assert sds == pytest.approx(fit.sd, rel=0.1)
    # An SD of so few replicates is known to 8 %, and the periods' scatter to 16 %.
    drawn = bootstrap_sds(fit, periods, 80, np.random.default_rng(1))
    assert drawn == pytest.approx(fit.sd, rel=0.5)


def test_segments_of_a_log_that_does_not_repeat_tell_the_device():
    rng = np.random.default_rng(5)
    step = 1e-3
    size = 1 << 15
    # The force is exact at every line of the whole log; windows leak little of so smooth a device.
    omega = 2.0 * np.pi * np.fft.rfftfreq(size, step)
    velocity = np.fft.rfft(0.1 * rng.standard_normal(size))
    force = np.fft.irfft((1.0j * omega * 0.05 + 4.0) * velocity, size)
    force += 0.5 * rng.standard_normal(size)
    log = TimeLog(step, force, np.fft.irfft(velocity, size), False)
    fit = fit_device(of_segments(log, 0.512, (20.0, 2000.0)), Terms())
    assert np.all(np.abs(fit.point - np.log([0.05, 4.0])) < MOST_SDS * fit.sd)


def test_a_response_is_fitted_with_its_coherence_and_without():
    rng = np.random.default_rng(5)
    omega = np.geomspace(10.0, 1000.0, 120)
    truth = 0.3j * omega + 4.0
    averages = 16
    coherence = np.full(omega.size, 0.99)
    sd = np.abs(truth) * np.sqrt(0.01 / 0.99 / (2 * averages))
    noise = rng.standard_normal((2, omega.size))
    response = truth + sd * (noise[0] + 1j * noise[1])
    found = {}
    for given in (coherence, None):
        measured = Response(omega, response, given)
        fit = fit_device(measured.spectra(averages, (0.0, np.inf)), Terms())
        assert np.all(np.abs(fit.point - np.log([0.3, 4.0])) < MOST_SDS * fit.sd)
        found[given is None] = fit.sd
    # Smooth neighbours show the same noise, to what a median of so many differences knows.
    assert found[True] == pytest.approx(found[False], rel=0.3)


def test_what_is_refused():
    log = simulate(Terms(), [1.0, 5.0], np.random.default_rng(7), Recording(noise_free=True))
    with pytest.raises(RefusalError, match="equal to the last digit"):
        Periods.of(log, 1.024, RECORDING.band).spectra()
    log = simulate(Terms(), [1.0, 5.0], np.random.default_rng(7), RECORDING)
    with pytest.raises(UsageError, match=r"1024\.5 samples of the log"):
        Periods.of(log, 1.0245, RECORDING.band)
    with pytest.raises(RefusalError, match="holds 3 periods"):
        Periods.of(log, 2.5, RECORDING.band)
    with pytest.raises(RefusalError, match="Only 2 frequencies"):
        Periods.of(log, 1.024, (20.0, 33.0)).spectra()
    with pytest.raises(UsageError, match="repeated periods"):
        identify(log, Request(terms=Terms(friction=True)))
    with pytest.raises(UsageError, match="must be 0 to 4"):
        Terms(modes=5)


def random_device(terms, rng):
    """A device of one mode within the band, or one whose log has a delay."""
    mass, damping = 10 ** rng.uniform([-1, 0], [0.5, 1.2])
    if not terms.modes:
        return [mass, damping, 10 ** rng.uniform(-4.3, -2.1)]
    resonance = np.exp(rng.uniform(np.log(60.0), np.log(500.0)))
    carried = mass * 10 ** rng.uniform(-1, 0.5)
    ratio = 10 ** rng.uniform(-2, -0.5)
    return [mass, damping, carried, carried * resonance**2, 2.0 * ratio * carried * resonance]


@pytest.mark.evidence(reduced=True)
@pytest.mark.parametrize("terms", [Terms(modes=1), Terms(delay=True)])
def test_climbs_from_rough_devices_end_no_lower_than_from_the_truth(terms):
    recording = Recording(length=256, periods=6)
    for seed in range(60 if LONG else 3):
        rng = np.random.default_rng([seed, 5])
        values = random_device(terms, rng)
        log = simulate(terms, values, rng, recording)
        spectra = Periods.of(log, recording.period, recording.band).spectra()
        fit = fit_device(spectra, terms)
        from_truth = climb(fit.density, np.log(values)).x
        reached, best = fit.density(np.array([fit.point, from_truth]))
        assert reached >= best - 0.01


@pytest.mark.parametrize("repeats", [4, 8, 30])
def test_noise_alone_stands_out_as_rarely_as_stated(repeats):
    """At one line in 10,000 of force, and as many of velocity, whatever the repeats."""
    rng = np.random.default_rng(repeats)
    length = 20_000
    logs = 10
    found = 0
    for _ in range(logs):
        force, motion = rng.standard_normal((2, repeats * length))
        log = TimeLog(1e-3, force, motion, is_position=False)
        found += Periods.of(log, length * 1e-3, (1.0, 3000.0)).omega.size
    lines = logs * length * (3000.0 - 1.0) * 1e-3 / (2.0 * np.pi)
    expected = 2e-4 * lines
    assert abs(found - expected) < 4.0 * np.sqrt(expected)
