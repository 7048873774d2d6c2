"""Comparison of the motion of two G-code files."""
