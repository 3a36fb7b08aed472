"""Waveforms of one file, shown."""
