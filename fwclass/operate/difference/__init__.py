"""`fwclass diff`: what changed between two deliveries."""
