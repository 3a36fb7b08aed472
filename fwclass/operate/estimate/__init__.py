"""What a survey will take, told before anything runs: from headers, one sampled part, and a model of costs."""
