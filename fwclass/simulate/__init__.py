"""A survey flown over a made-up city: recorded like a real sensor's, with the truth beside it."""
