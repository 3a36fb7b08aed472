"""Waveforms to echoes: Gaussian decomposition."""
