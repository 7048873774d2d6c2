"""The chain of stages, conversions of whole files, and their reports."""
