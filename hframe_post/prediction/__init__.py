"""Where the nozzle goes, how far off the path, and the figures of that."""
