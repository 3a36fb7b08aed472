"""Studies: variants of a classifier, trained on one sample and judged on the same echoes."""
