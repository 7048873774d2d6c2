"""What each firmware does with a stream, and the commands around it."""
