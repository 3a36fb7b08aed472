"""The level of standing and running water, and its shores."""
