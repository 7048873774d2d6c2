"""The motion of a sweep, recordings of it by accelerometers, and their common clock."""
