"""Choice of window, effort, acceleration and jerk."""
