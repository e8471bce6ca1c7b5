"""Other samplers of the same model, one in each file."""
