"""Files that are delivered: clouds, rasters, vectors, projects, reports, pictures."""
