"""Motor commands from samples: compensated, standing still at stops, and checked."""
