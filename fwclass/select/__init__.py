"""Choosing features: which of many candidates classify best in places that did not choose them, and at what cost."""
