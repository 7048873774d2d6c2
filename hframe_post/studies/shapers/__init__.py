"""Input shapers on the same print, for comparison."""
