"""Whether a compensated print moves better on the real machine."""
