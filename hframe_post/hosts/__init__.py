"""Files that run inside Moonraker and OctoPrint, in their Python: they import nothing from here."""
