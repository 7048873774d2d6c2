"""Marlin as a player of the stream."""
