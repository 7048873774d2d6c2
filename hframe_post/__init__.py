"""Feedforward compensation of racking and ringing for H-frame 3D printers, as G-code."""

__version__ = "0.1.0"
