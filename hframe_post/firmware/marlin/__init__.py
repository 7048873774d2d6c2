"""Marlin."""
