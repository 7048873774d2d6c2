"""Measured proof that compensation helps on the machine."""
