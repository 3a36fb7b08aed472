"""The stages of a run as records, one file a subject, and the parts that are planned from them."""
