"""Features of echoes from their neighbours: spheres, cylinders, nearest echoes, cells and pulses."""
