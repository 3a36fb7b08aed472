"""What a run keeps: parts, receipts, generations and locks, in a directory or on object storage."""
