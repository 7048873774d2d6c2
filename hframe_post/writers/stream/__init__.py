"""Samples to a stream of G-code."""
