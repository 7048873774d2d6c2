"""Klipper."""
