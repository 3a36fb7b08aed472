"""Trained models for fwclass: a directory each, without code. `fwclass models` lists them."""
