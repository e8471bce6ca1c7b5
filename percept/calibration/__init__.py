"""Calibration: the real coverage of intervals and boundaries, by simulating studies and refitting them."""
