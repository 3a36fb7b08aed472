"""`fwclass schedule`: when to run, what an inbox holds, the run as a process of its own, and whom it tells."""
