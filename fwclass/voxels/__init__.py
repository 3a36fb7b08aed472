"""Products for those who want the waveform, not echoes: voxels and vertical profiles."""
