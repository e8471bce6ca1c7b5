"""What takes minutes to show: searches beside fine grids, verdicts beside motion in time."""
