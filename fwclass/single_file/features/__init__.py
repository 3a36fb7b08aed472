"""`fwclass features`: the features of every echo of one file, and the lists of what there is."""
