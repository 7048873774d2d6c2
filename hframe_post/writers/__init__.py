"""Out: G-code, steps and samples, and the files that hold them."""
