"""The figures and tables of the paper, computed again."""
