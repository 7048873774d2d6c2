"""Files that run inside Klipper and Moonraker, in their Python: they import nothing from here."""
