"""A robot with 5 degrees of freedom points its drill anywhere in a cone: single directions, verified turns."""
