"""The engine: makes the parts of any stage, in a plain loop or on Dask, and knows no room."""
