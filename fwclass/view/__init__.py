"""The viewer: echoes as blocks that a page draws, the page, and the server of both. It knows no run: see `scene`."""
