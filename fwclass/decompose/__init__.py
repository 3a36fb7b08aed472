"""Waveforms to echoes: the system's pulse, measured on the survey, fitted to every echo by least squares."""
