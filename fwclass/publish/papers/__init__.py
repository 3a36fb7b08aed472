"""Pages that set a run's figures beside those of a paper."""
