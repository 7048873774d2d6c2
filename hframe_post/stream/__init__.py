"""Types that flow from stage to stage, cuts of a stream, and how stages are run and timed."""
