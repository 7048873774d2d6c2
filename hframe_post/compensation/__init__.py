"""Samples to commands for the motors, settled at stops and safe."""
