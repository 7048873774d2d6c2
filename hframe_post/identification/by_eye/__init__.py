"""A printer's model from prints and a ruler, without a sensor."""
