"""Conversion of many files, in processes here or on a cluster."""
