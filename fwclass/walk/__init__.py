"""The walk of a run: what a workflow is, and how its stages are made one after the other."""
