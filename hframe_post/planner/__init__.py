"""From moves to a jerk-limited trajectory, sampled every millisecond."""
