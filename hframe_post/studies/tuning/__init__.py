"""Choice of window and effort."""
