from __future__ import annotations

import mpmath
import numpy as np
import pytest

from percept.boundary.band import (
    BandOwner,
    band_laws,
    fit_law,
    law_band,
    leave_one_out,
)
from percept.results import BandLaw

Z = np.geomspace(1.0, 5000.0, 40)
Z4 = np.array([1.0, 10.0, 100.0, 1000.0])
WHOSE = BandOwner(method="bayesian", family="normal")
TRUE = {"weber": (0.12,), "offset": (0.8, 0.1), "power": (0.5, 0.8)}


def simulated(law: str, count: int, seed: int = 1, sizes: np.ndarray = Z) -> np.ndarray:
    scatter = np.random.default_rng(seed).standard_normal((count, sizes.size))
    return law_band(law, np.array([TRUE[law]]), sizes) * np.exp(0.1 * scatter)


def laws_of(impedance: np.ndarray, draws: np.ndarray) -> dict[str, BandLaw]:
    names = tuple("ABCDEFG"[: impedance.size])
    return {law.model: law for law in band_laws(names, impedance, None, draws, WHOSE, level=0.9)}


@pytest.mark.parametrize("law", ["weber", "offset", "power"])
def test_recovers_its_own_parameters(law: str) -> None:
    fitted = fit_law(law, Z, simulated(law, 400))
    error = fitted.std(axis=0, ddof=1) / 20.0
    # Logarithms average without bias; their exponentials have one of half the variance.
    bias = 0.5 * (fitted.std(axis=0) ** 2) / np.abs(TRUE[law])
    assert np.all(np.abs(fitted.mean(axis=0) - TRUE[law]) < 4 * error + 2 * bias)


def test_offset_is_exact_to_more_digits_than_its_cost_shows() -> None:
    bands = simulated("offset", 40, seed=5)
    checked = 0
    for row, (c, w) in zip(bands, fit_law("offset", Z, bands), strict=True):
        if not c:
            continue
        z, y = (
            [mpmath.mpf(v) for v in Z.tolist()],
            [mpmath.log(mpmath.mpf(v)) for v in row.tolist()],
        )

        def slope(t: mpmath.mpf, z: list[mpmath.mpf] = z, y: list[mpmath.mpf] = y) -> mpmath.mpf:
            off = [b - mpmath.log(mpmath.exp(t) + a) for a, b in zip(z, y, strict=True)]
            mean = mpmath.fsum(off) / len(off)
            return mpmath.fsum(
                (o - mean) / (1 + a * mpmath.exp(-t)) for o, a in zip(off, z, strict=True)
            )

        with mpmath.workdps(40):
            exact = mpmath.exp(mpmath.findroot(slope, mpmath.log(c / w)))
        assert c / w == pytest.approx(float(exact), rel=1e-11)
        checked += 1
    assert checked > 20


def test_no_offset_where_bands_fall_short_at_low_impedance() -> None:
    bands = law_band("power", np.array([[0.1, 1.3]]), Z)
    assert fit_law("offset", Z, bands)[0, 0] == 0.0


def test_left_out_is_predicted_from_the_others_only() -> None:
    bands = simulated("power", 3)[:, :6]
    error, fits = leave_one_out("power", Z[:6], bands)
    kept = np.arange(6) != 2
    by_hand = np.polynomial.polynomial.polyfit(np.log(Z[:6][kept]), np.log(bands[:, kept]).T, 1)
    np.testing.assert_allclose(fits[2][:, 1], by_hand[1])
    np.testing.assert_allclose(
        error[:, 2], by_hand[0] + by_hand[1] * np.log(Z[2]) - np.log(bands[:, 2])
    )


def test_one_environment_carrying_the_offset_is_named() -> None:
    z = np.array([1.0, 100.0, 1000.0, 2500.0, 5000.0])
    bands = np.array([1.2, 10.0, 100.0, 250.0, 500.0])
    draws = bands * np.exp(0.02 * np.random.default_rng(1).standard_normal((300, 5)))
    names = ("A", "B", "C", "D", "E")
    laws = list(band_laws(names, z, bands, draws, WHOSE, level=0.9))
    offset = next(law for law in laws if law.model == "offset")
    assert offset.sentence.endswith(" The offset rests on A alone.")
    assert "With one reference left out, " in offset.sentence
    assert offset.parameters["c"].lower < 1.1 < offset.parameters["c"].upper
    assert sum(law.best or 0.0 for law in laws) == pytest.approx(1.0)


def powers(exponent: float, count: int = 60) -> np.ndarray:
    return Z4**exponent * np.exp(0.05 * np.random.default_rng(2).standard_normal((count, 4)))


@pytest.mark.parametrize(("exponent", "growing"), [(1.5, "faster"), (0.5, "slower")])
def test_an_exponent_other_than_one_is_said_to_grow_faster_or_slower(
    exponent: float, growing: str
) -> None:
    assert laws_of(Z4, powers(exponent))["power"].sentence.startswith(
        f"The band grows {growing} than the impedance: the exponent's interval does not hold 1. "
    )


def test_sentences_speak_of_their_own_law() -> None:
    names = tuple("ABCDEFG"[: Z.size])
    draws = 0.3 * Z * np.exp(0.05 * np.random.default_rng(8).normal(size=(200, Z.size)))
    weber, offset, power = band_laws(names, Z, 0.3 * Z, draws, WHOSE, level=0.9)
    assert weber.sentence.startswith(
        "The band is 0.3 times the impedance. With one reference left out, Weber's law "
    )
    assert offset.sentence.startswith(
        "The offset vanishes, and the band is 0.3 times the impedance. "
    )
    assert "the law with an offset is typically off by a factor " in offset.sentence
    assert power.sentence.startswith(
        "The exponent's interval holds 1: Weber's law is not ruled out. "
    )
    assert "the power law is typically off by a factor " in power.sentence
    rough = 0.1 + 0.3 * Z
    draws = rough * np.exp(0.4 * np.random.default_rng(9).normal(size=(400, Z.size)))
    _, reaching, _ = band_laws(names, Z, rough, draws, WHOSE, level=0.9)
    assert reaching.parameters["c"].lower == 0.0 < reaching.parameters["c"].value
    assert (
        "an offset, whose interval reaches zero, and a share of the impedance" in reaching.sentence
    )


def test_the_law_that_is_clearly_ahead_is_named() -> None:
    laws = laws_of(10.0 * Z4, simulated("power", 40, 5, 10.0 * Z4))
    assert laws["power"].sentence.endswith("; it is ahead of both other laws.")
    for behind in (laws["weber"], laws["offset"]):
        assert behind.sentence.endswith("; another law does better.")


def test_sizes_too_close_together_for_a_law_give_none() -> None:
    # Of these bands a power of about 2,000 is the best fit: its factor leaves the range of doubles.
    sizes = np.array([80.0, 80.1, 80.2, 80.3])
    draws = np.array([[1.0, 20.0, 150.0, 1000.0]])
    assert fit_law("power", sizes[1:], draws[:, 1:])[0, 1] > 500.0
    assert laws_of(sizes, draws) == {}
