"""A band along tile borders computed once more in tiles that lie elsewhere, against what the run has there."""
