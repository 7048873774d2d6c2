"""G-code in: text to moves, standing moves and lines that pass through."""
