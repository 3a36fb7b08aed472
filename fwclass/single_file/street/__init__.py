"""Commands on recordings of a vehicle's 2-D scanner."""
