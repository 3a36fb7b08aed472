"""What is done with a run besides running it: estimate, status, seams, schedule, history."""
