"""Impulse responses, estimated with as much freedom as the recordings prove."""
