"""Recordings: what is played, what a sensor wrote, and both on one clock."""
