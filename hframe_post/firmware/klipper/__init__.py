"""How Klipper plays a stream."""
