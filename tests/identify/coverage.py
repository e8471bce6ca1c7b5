"""Whether regions of (m, b) cover, and whether P(stable) is calibrated, over simulated logs.

    python -m tests.identify.coverage --out reports/coverage

Every log is simulated. Regions are by maximum likelihood and information, and P(stable) is summed
over a grid of the posterior.
"""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import stats

from percept import haptics
from percept.identify.fit import Whitened, fit_device
from percept.identify.model import Parameter, Terms
from percept.identify.spectra import Periods
from percept.provenance import made_by, markdown_table
from tests.identify.simulated import DEVICES, Recording, simulate

LEVEL = 0.95
LOGS = 1000
#: Standard errors that chance alone leaves one of three shares, and one of five bins, within.
MOST_ERRORS = 3.0
RECORDING = Recording()
#: So noisy a log knows the damping to a tenth: P(stable) then lies between zero and one.
NOISY = Recording(length=256, periods=8, force_noise=8.0, speed_noise=0.01)
#: The coupling whose stability is asked, and the SD of the devices' log damping about its need.
COUPLING = haptics.Coupling(50e3, 100.0)
PERIOD = 1e-3
PRIOR_SD = 0.2
BINS = 5


@dataclass
class Share:
    """A share of trials beside the probability that it should have."""

    name: str
    expected: float
    found: float
    error: float
    count: int

    @property
    def deviation(self):
        """Standard errors between both."""
        return (self.found - self.expected) / self.error


def coverage(name, logs):
    """Return the share of logs whose 95 % region of (m, b) holds the truth."""
    terms, values = DEVICES[name]
    truth = np.log(values)[:2]
    edge = stats.chi2.ppf(LEVEL, 2)
    inside = 0
    for seed in range(logs):
        rng = np.random.default_rng([seed, list(DEVICES).index(name), 11])
        log = simulate(terms, values, rng, RECORDING)
        fit = fit_device(Periods.of(log, RECORDING.period, RECORDING.band).spectra(), terms)
        apart = fit.point[:2] - truth
        distance = apart @ np.linalg.solve(fit.covariance[:2, :2], apart)
        inside += distance <= edge
    error = np.sqrt(LEVEL * (1.0 - LEVEL) / logs)
    return Share(name, LEVEL, inside / logs, error, logs)


def probability_above(fit, log_damping):
    """Return the posterior probability of more damping, over a grid of six SDs either way."""
    whitened = Whitened(fit.density, fit.point, fit.covariance)
    axis = np.linspace(-6.0, 6.0, 81)
    z = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    values = whitened(z)
    weights = np.exp(values - values.max())
    above = whitened.points(z)[:, 1] > log_damping
    return weights[above].sum() / weights.sum()


def calibration(logs):
    """Return the share of stable devices by bins of P(stable), devices being from the prior.

    The fit has the prior that the devices are drawn from.
    """
    terms = Terms()
    needed = haptics.required_damping(COUPLING, PERIOD).damping
    parameters = [
        Parameter("mass", "kg", 1.0, 0.5),
        Parameter("damping", "N·s/m", needed, PRIOR_SD),
    ]
    probability = np.empty(logs)
    stable = np.empty(logs)
    for seed in range(logs):
        rng = np.random.default_rng([seed, 17])
        values = [p.median * np.exp(p.sd * rng.standard_normal()) for p in parameters]
        log = simulate(terms, values, rng, NOISY)
        spectra = Periods.of(log, NOISY.period, NOISY.band).spectra()
        fit = fit_device(spectra, terms, parameters)
        probability[seed] = probability_above(fit, np.log(needed))
        stable[seed] = values[1] > needed
    shares = []
    edges = np.linspace(0.0, 1.0, BINS + 1)
    which = np.clip(np.digitize(probability, edges) - 1, 0, BINS - 1)
    for index in range(BINS):
        inside = which == index
        expected = probability[inside]
        error = np.sqrt((expected * (1.0 - expected)).sum()) / inside.sum()
        name = f"P(stable) {edges[index]:.1f} to {edges[index + 1]:.1f}"
        count = int(inside.sum())
        shares.append(Share(name, expected.mean(), stable[inside].mean(), error, count))
    error = np.sqrt((probability * (1.0 - probability)).sum()) / logs
    shares.append(Share("all", probability.mean(), stable.mean(), error, logs))
    return shares


_HEAD = """# Devices from simulated logs

All logs are simulated: a multisine motion of {lines} lines from {low:g} to {high:g} rad/s,
{periods} periods, white noise on force and velocity. Regions are by maximum likelihood and
information. P(stable) is summed over a grid of the posterior: what emcee samples.

"""


def main():
    """Write `devices.md`."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the page")
    parser.add_argument("--logs", type=int, default=LOGS, help=f"logs of each device ({LOGS})")
    parsed = parser.parse_args()
    covered = [coverage(name, parsed.logs) for name in DEVICES]
    calibrated = calibration(parsed.logs)
    heads = ["", "expected", "found", "standard error", "standard errors apart", "logs"]
    pages = []
    for title, shares in (
        (f"Share of {100 * LEVEL:g} % regions of (m, b) that hold the truth", covered),
        ("Share of stable devices, drawn from the prior", calibrated),
    ):
        rows = [
            (
                s.name,
                f"{s.expected:.4f}",
                f"{s.found:.4f}",
                f"{s.error:.4f}",
                f"{s.deviation:+.2f}",
                s.count,
            )
            for s in shares
        ]
        pages.append(f"## {title}\n\n{markdown_table(heads, rows)}\n")
    lines = int((RECORDING.highest - RECORDING.lowest) * RECORDING.period / (2.0 * np.pi))
    head = _HEAD.format(
        lines=lines, low=RECORDING.lowest, high=RECORDING.highest, periods=RECORDING.periods
    )
    command = f"python -m tests.identify.coverage {shlex.join(sys.argv[1:])}"
    made = made_by(command, ("numpy", "scipy")).sentence
    parsed.out.mkdir(parents=True, exist_ok=True)
    text = head + "\n".join(pages) + f"\n{made}\n"
    (parsed.out / "devices.md").write_text(text, encoding="utf-8")
    sys.stdout.write(text)


if __name__ == "__main__":
    main()
