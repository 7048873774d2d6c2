"""How Marlin plays a stream."""
