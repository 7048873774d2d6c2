"""What the data say against a linear model, and how well it is known."""
