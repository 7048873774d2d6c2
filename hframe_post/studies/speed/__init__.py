"""The fastest print within an error bound."""
