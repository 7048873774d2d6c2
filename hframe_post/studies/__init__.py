"""What would it do? Simulation, tuning, printers that are not quite the model."""
