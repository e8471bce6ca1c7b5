"""A device measured: from a log of force and motion to mass, damping, modes and their posterior."""
