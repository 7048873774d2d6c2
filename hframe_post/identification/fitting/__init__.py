"""Models of the printer fitted to frequency responses."""
