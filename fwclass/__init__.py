"""fwclass: classification of airborne full-waveform lidar surveys."""

__version__ = "0.1.0"
