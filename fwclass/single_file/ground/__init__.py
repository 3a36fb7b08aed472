"""The commands `fwclass ground` and `fwclass normalize`: one file, without a run directory."""
