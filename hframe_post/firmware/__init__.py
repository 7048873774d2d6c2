"""What each firmware reads, how it moves, and what its own files say."""
