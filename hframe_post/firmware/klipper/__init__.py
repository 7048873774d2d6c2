"""Klipper as a player of the stream."""
