"""The whole tool: the stages joined, what is told of them, file to file."""
