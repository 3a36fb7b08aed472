"""Reference classes of echoes: from polygons, another cloud or single echoes, and whether they fit their places."""
