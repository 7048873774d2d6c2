"""The maths: transfer functions, the plant, filtered B-splines, stops, kinematics, corners."""
