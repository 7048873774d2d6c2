"""G-code in: text to moves, moves at rest and lines that pass through."""
