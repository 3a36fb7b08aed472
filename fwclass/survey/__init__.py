"""The survey: its files, found and checked, the coordinate systems and boxes they have, and the tiles they fill."""
