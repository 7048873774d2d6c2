"""Samples to the step times of the motors."""
