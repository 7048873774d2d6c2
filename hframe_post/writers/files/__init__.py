"""Output files: complete or not at all."""
