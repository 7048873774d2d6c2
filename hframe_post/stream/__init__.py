"""What flows from stage to stage, and how it is cut, joined and prefetched."""
