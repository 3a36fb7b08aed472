"""How good a survey is: density, voids, differences of its strips, noise, and check points; without classes."""
