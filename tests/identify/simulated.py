"""Simulated logs of devices: a multisine motion repeated, exact force, white noise on both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from percept.identify.model import DeviceModel, Terms
from percept.identify.spectra import TimeLog

#: The three devices whose coverage is measured: terms, and parameters in SI units.
DEVICES = {
    "rigid": (Terms(), [1.0, 5.0]),
    "one mode": (Terms(modes=1), [1.0, 5.0, 0.2, 8e3, 2.0]),
    "delay": (Terms(delay=True), [1.0, 5.0, 2e-3]),
}


@dataclass
class Recording:
    """How a log is made."""

    step: float = 1e-3  # s
    length: int = 1024  # samples of a period
    periods: int = 8
    lowest: float = 20.0  # rad/s
    highest: float = 700.0  # rad/s
    speed: float = 0.02  # m/s, amplitude of each line
    force_noise: float = 0.3  # N, SD of a sample
    speed_noise: float = 0.002  # m/s, SD of a sample

    noise_free: bool = False

    @property
    def period(self):
        return self.step * self.length

    @property
    def band(self):
        return self.lowest, self.highest


def simulate(terms, values, rng, recording=None, *, position=False):
    """Return a log of a device that moves as a multisine with random phases."""
    recording = recording or Recording()
    length = recording.length
    omega = 2 * np.pi * np.fft.rfftfreq(length, recording.step)
    excited = (omega >= recording.lowest) & (omega <= recording.highest)
    velocity = np.zeros(omega.size, dtype=complex)
    phases = rng.uniform(0, 2 * np.pi, excited.sum())
    velocity[excited] = 0.5 * length * recording.speed * np.exp(1j * phases)
    names = [parameter.name for parameter in terms.parameters]
    given = dict(zip(names, values, strict=True))
    impedance = np.zeros(omega.size, dtype=complex)
    points = np.log(np.array([values]))
    impedance[1:] = DeviceModel(terms).impedance(points, omega[1:])[0]
    force = impedance * velocity
    moved = np.fft.irfft(velocity, length)
    force = force + given.get("coulomb", 0.0) * np.fft.rfft(np.sign(moved))
    force = force * np.exp(-1j * omega * given.get("delay", 0.0))
    force = np.tile(np.fft.irfft(force, length), recording.periods)
    motion = moved
    if position:
        shifted = np.zeros_like(velocity)
        shifted[1:] = velocity[1:] / (1j * omega[1:])
        motion = np.fft.irfft(shifted, length)
    motion = np.tile(motion, recording.periods)
    if recording.noise_free:
        return TimeLog(recording.step, force, motion, position)
    size = motion.size
    force = force + recording.force_noise * rng.standard_normal(size)
    noise = recording.speed_noise * (recording.step if position else 1.0)
    motion = motion + noise * rng.standard_normal(size)
    return TimeLog(recording.step, force, motion, position)
