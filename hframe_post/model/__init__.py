"""The maths: transfer functions, the plant, filtered B-splines, kinematics, corners."""
