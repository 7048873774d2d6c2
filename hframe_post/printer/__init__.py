"""Printer profiles: their settings; how they are chosen, loaded, created and changed."""
