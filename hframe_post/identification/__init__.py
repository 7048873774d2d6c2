"""A printer's own model from sweeps and accelerometers."""
