"""What a log tells at each frequency: mean force and velocity, and the noise measured of both.

A log of repeated periods is transformed period by period. What differs between periods is noise,
so its variances and its covariance are measured at every line. Without repeats the log is cut into
segments, and all that the velocity does not explain of the force counts as noise of the force.
A spectrum analyser's response with its coherence is the same, cut and averaged by the analyser.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from percept.errors import RefusalError, UsageError

__all__ = ["Periods", "Spectra", "TimeLog", "of_response", "of_segments"]

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

#: Fewest repeats: the noise of a line has two degrees of freedom per repeat beyond the first.
_FEWEST_REPEATS = 4
#: Chance that noise alone makes a line of force, or of velocity, stand out.
_FALSE_LINES = 1e-4
#: Fewest lines: eight real numbers, for the two parameters of a rigid device and its misfit.
_FEWEST_LINES = 4
#: Fraction by which a duration may miss a whole number of samples: the step of a log is rounded.
_ROUNDING = 1e-6
#: Every second line is used. Under a Hann window neighbours share 44 % of their noise's power, and
#: second neighbours 3 %.
_HANN_STEP = 2
#: Largest ωT, rad. A central difference has the gain sin(ωT)/(ωT). Its correction is 4 here, and
#: grows without bound up to π.
_LARGEST_ANGLE = 2.5


@dataclasses.dataclass(frozen=True, eq=False)
class Spectra:
    """Means over R repeats at K lines, and sums of squares of the repeats about the means."""

    omega: Array  # (K,) rad/s
    force: ComplexArray  # (K,) N, in the transform's scale
    velocity: ComplexArray  # (K,) m/s
    sign: ComplexArray  # (K,) Of the velocity's sign; zero for responses
    force_scatter: Array  # (K,) Σ abs(F - mean)²
    velocity_scatter: Array  # (K,)
    cross_scatter: ComplexArray  # (K,) Σ (F - mean)·conj(V - mean)
    repeats: int

    def __post_init__(self) -> None:
        if self.repeats < _FEWEST_REPEATS:
            raise RefusalError(
                f"The log holds {self.repeats} repeats; the noise needs {_FEWEST_REPEATS} or more.",
                hint="Record longer, or give a shorter period or segment.",
            )
        if self.omega.size < _FEWEST_LINES:
            raise RefusalError(
                f"Only {self.omega.size} frequencies of the log stand out of its noise.",
                hint="Excite the device more strongly, or widen the range of frequencies.",
            )
        if not np.all(self.force_scatter > 0.0):
            raise RefusalError(
                "The repeats are equal to the last digit, so the log shows no noise.",
                hint="Give the log as it was recorded, not an average of its periods.",
            )

    @property
    def response(self) -> ComplexArray:
        """Measured impedance, delay and friction included, N·s/m, (K,)."""
        return self.force / self.velocity

    @property
    def coherence(self) -> Array:
        """Share of the force's power that is not noise, (K,)."""
        power = self.repeats * np.abs(self.force) ** 2
        return power / (power + self.force_scatter)


@dataclasses.dataclass(frozen=True, eq=False)
class TimeLog:
    """Force and motion at even times."""

    step: float  # s between samples
    force: Array  # (N,) N
    motion: Array  # (N,) m/s, or m
    is_position: bool  # Whether `motion` is a position


@dataclasses.dataclass(frozen=True, eq=False)
class Periods:
    """Transforms of R periods at K lines, which a bootstrap draws from."""

    omega: Array  # (K,) rad/s
    force: ComplexArray  # (K, R) N
    velocity: ComplexArray  # (K, R) m/s
    sign: ComplexArray  # (K,) Of the mean period's velocity

    @classmethod
    def of(cls, log: TimeLog, period: float, band: tuple[float, float]) -> Periods:
        """Transform the last whole periods of a log; what comes before them has settled.

        Parameters
        ----------
        log : TimeLog
            Force and motion.
        period : float
            Of the excitation, s; a whole number of samples.
        band : tuple of float
            Lines used, rad/s.

        Raises
        ------
        UsageError
            A period that is no whole number of samples.
        RefusalError
            Fewer than four periods, or four lines that stand out of the noise.
        """
        length = _samples(log, period)
        repeats = log.force.size // length
        if repeats < _FEWEST_REPEATS:
            raise RefusalError(
                f"The log holds {repeats} periods; the noise needs {_FEWEST_REPEATS} or more.",
                hint="Record more periods.",
            )
        force = _periodwise(log.force, length)
        velocity = _periodwise(log.motion, length)
        omega = _frequencies(length, log.step)
        if log.is_position:
            velocity = 1j * omega[:, None] * velocity
        if length % 2 == 0:
            # At Nyquist a transform has no phase.
            velocity[-1] = 0.0
        mean_velocity = np.fft.irfft(velocity.mean(axis=1), length)
        sign = np.fft.rfft(np.sign(mean_velocity))
        used = _within(omega, band)
        # To ask both would choose, at a weak force, the lines whose noise happens to add to it.
        used &= _stands_out(force) | _stands_out(velocity)
        return cls(omega[used], force[used], velocity[used], sign[used])

    def spectra(self, which: NDArray[np.intp] | None = None) -> Spectra:
        """Average all periods, or the periods of these indices."""
        chosen = slice(None) if which is None else which
        force = self.force[:, chosen]
        velocity = self.velocity[:, chosen]
        mean_force = force.mean(axis=1)
        mean_velocity = velocity.mean(axis=1)
        force_noise = force - mean_force[:, None]
        velocity_noise = velocity - mean_velocity[:, None]
        return Spectra(
            omega=self.omega,
            force=mean_force,
            velocity=mean_velocity,
            sign=self.sign,
            force_scatter=(np.abs(force_noise) ** 2).sum(axis=1),
            velocity_scatter=(np.abs(velocity_noise) ** 2).sum(axis=1),
            cross_scatter=(force_noise * velocity_noise.conj()).sum(axis=1),
            repeats=force.shape[1],
        )


def of_segments(log: TimeLog, segment: float, band: tuple[float, float]) -> Spectra:
    """Average a log that does not repeat over Hann windows, without overlap.

    Parameters
    ----------
    log : TimeLog
        Force and motion.
    segment : float
        Length of a window, s; a whole number of samples.
    band : tuple of float
        Lines used, rad/s.

    Returns
    -------
    Spectra
        The response that explains most of the force, and what it leaves as the noise.

    Raises
    ------
    UsageError
        A segment that is no whole number of samples.
    RefusalError
        Fewer than four segments.
    """
    length = _samples(log, segment)
    omega = _frequencies(length, log.step)
    motion = log.motion
    correction = np.ones(omega.size)
    used = _within(omega, band)
    if log.is_position:
        motion = np.gradient(log.motion, log.step)
        angle = omega * log.step
        used &= angle <= _LARGEST_ANGLE
        correction[used] = angle[used] / np.sin(angle[used])
    window = np.hanning(length + 1)[:-1]
    force = _periodwise(log.force, length, window)
    velocity = correction[:, None] * _periodwise(motion, length, window)
    lines = np.flatnonzero(used)[::_HANN_STEP]
    cross = (force * velocity.conj()).mean(axis=1)[lines]
    velocity_power = (np.abs(velocity) ** 2).mean(axis=1)[lines]
    force_power = (np.abs(force) ** 2).mean(axis=1)[lines]
    coherence = np.abs(cross) ** 2 / (velocity_power * force_power)
    impedance = cross / velocity_power
    return of_response(omega[lines], impedance, coherence, averages=force.shape[1])


def of_response(omega: Array, impedance: ComplexArray, coherence: Array, averages: int) -> Spectra:
    """Take a response and its coherence, as averages of so many segments.

    Parameters
    ----------
    omega : ndarray, shape (K,)
        rad/s.
    impedance : ndarray of complex, shape (K,)
        N·s/m.
    coherence : ndarray, shape (K,)
        Between force and velocity, above 0 and below 1.
    averages : int
        Independent segments behind each value.

    Returns
    -------
    Spectra
        Of a velocity of one, without noise.

    Notes
    -----
    The variance of abs(Z) relative to its square is (1 - γ²)/(2γ²·averages) (Bendat and Piersol,
    Random Data, 2010, section 9.2).
    """
    force_power = averages * np.abs(impedance) ** 2
    noise = force_power * (1.0 - coherence) / coherence
    zero = np.zeros(omega.size)
    return Spectra(
        omega=omega,
        force=impedance,
        velocity=np.ones(omega.size, dtype=complex),
        sign=zero.astype(complex),
        force_scatter=noise,
        velocity_scatter=zero,
        cross_scatter=zero.astype(complex),
        repeats=averages,
    )


def _samples(log: TimeLog, duration: float) -> int:
    """Return how many samples a duration has; refuse a fraction of one."""
    samples = duration / log.step
    length = round(samples)
    error = abs(samples - length)
    if length < 2 or error > _ROUNDING * samples:
        raise UsageError(
            f"A period of {duration:g} s has {samples:.6g} samples of the log, whose step"
            f" is {log.step:.6g} s.",
            hint="Give a whole number of samples, two or more.",
        )
    return length


def _frequencies(length: int, step: float) -> Array:
    """Return the lines of a transform of a length, rad/s."""
    return np.asarray(2.0 * np.pi * np.fft.rfftfreq(length, step), dtype=np.float64)


def _within(omega: Array, band: tuple[float, float]) -> NDArray[np.bool_]:
    """Say which lines lie in a band; zero frequency never does."""
    lowest, highest = band
    return (omega > 0.0) & (omega >= lowest) & (omega <= highest)


def _periodwise(values: Array, length: int, window: Array | float = 1.0) -> ComplexArray:
    """Transform the last whole stretches of a length, (K, R)."""
    repeats = values.size // length
    first = values.size - repeats * length
    stretches = values[first:].reshape(repeats, length)
    return np.fft.rfft(stretches * window, axis=1).T


def _stands_out(repeated: ComplexArray) -> NDArray[np.bool_]:
    """Say at which lines the mean of repeats is well above the noise of a mean.

    Of noise alone the power over its estimate has an F distribution of 2 and 2(R - 1) degrees of
    freedom, which exceeds x with the chance (1 + x/(R - 1))^-(R - 1).
    """
    mean = repeated.mean(axis=1)
    degrees = repeated.shape[1] - 1
    noise = repeated.var(axis=1) / degrees
    least_power = degrees * (_FALSE_LINES ** (-1.0 / degrees) - 1.0)
    return np.abs(mean) ** 2 > least_power * noise
