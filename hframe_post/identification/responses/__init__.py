"""Frequency responses measured from recordings."""
