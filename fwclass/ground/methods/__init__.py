"""Ground filters, one a file, with what several of them share."""
