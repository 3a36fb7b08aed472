"""Reading LAS, LAZ and COPC files, with or without waveform packets."""
