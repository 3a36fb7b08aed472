"""Commands on one file."""
