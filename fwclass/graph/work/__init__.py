"""What a part does: adapters between the store and the rooms, one function per stage."""
