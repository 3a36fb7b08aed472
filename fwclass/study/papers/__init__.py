"""The papers as runs: variants of a classifier on one sample and one test set, their figures beside the paper's."""
