"""How good an answer is: confusion counts and their figures, intervals, objects, distributions of features by class."""
