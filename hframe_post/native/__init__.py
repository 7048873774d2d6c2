"""Loops in C, where they could be built: each does what a function in numpy does, to the bit."""
