"""What a run tells at its end: figures from receipts, remarks, and judges of what no sound input shows."""
