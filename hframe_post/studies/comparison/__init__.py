"""Whether two files ask for the same motion."""
