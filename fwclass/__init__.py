"""fwclass: classification of airborne full-waveform lidar surveys."""

from fwclass.isolation import guard

__version__ = "0.1.0"

guard()
