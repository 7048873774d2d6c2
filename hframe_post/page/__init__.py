"""The report as one page: what a browser shows without a network."""
