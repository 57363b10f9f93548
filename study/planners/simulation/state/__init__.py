"""What changes while a plan is made, and the path that is recorded."""
