"""Printer profiles: what they say, how they are checked, loaded and edited."""
