"""Predicted errors of every strategy for one print."""
