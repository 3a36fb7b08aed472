"""Classifiers of other kinds, trained by scikit-learn, for comparison."""
