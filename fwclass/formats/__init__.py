"""Foreign formats that several rooms read or write: LAS and LAZ, extra bytes, coordinate systems, vector files."""
