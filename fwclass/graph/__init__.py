"""Which parts a run has, and what each needs: the edges of the graph, and no more than the edges."""
