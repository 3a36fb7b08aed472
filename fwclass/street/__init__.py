"""Street trees from a vehicle's 2-D scanner, frame by frame (Li 2018)."""
