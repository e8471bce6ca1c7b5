"""How often verdicts err."""
