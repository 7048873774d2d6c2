"""Nonlinearity, changes along x, and uncertainty of the model."""
