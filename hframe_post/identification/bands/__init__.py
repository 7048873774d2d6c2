"""Bands of motor speed that shake the nozzle: the strokes that show them, and what these say."""
