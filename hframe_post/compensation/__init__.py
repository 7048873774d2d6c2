"""Motor commands from samples: compensated, dwelling at stops, and checked."""
