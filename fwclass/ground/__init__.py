"""The ground among the echoes: noise, filters, terrain, and parameters that are chosen from the echoes themselves."""
