"""Radiometry: range, incidence, cross-section, backscatter coefficient and reflectance of echoes."""
