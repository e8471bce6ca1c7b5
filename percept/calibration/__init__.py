"""Calibration: what intervals and boundaries really cover, by simulating studies and refitting."""
