"""The library in use."""
