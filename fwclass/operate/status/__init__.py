"""How each part of a run stands, and why: read from receipts, failures and the plan; nothing is computed."""
