"""Runs of one transfer function that a sensor began to record a little early or late.

A delay by τ multiplies a response with e^{−jωτ}. Between runs of the same it shows as a
phase that grows with frequency, whatever the response.
"""

from __future__ import annotations
