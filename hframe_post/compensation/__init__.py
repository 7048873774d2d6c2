"""Samples to commands for the motors, which stand at stops and are safe."""
