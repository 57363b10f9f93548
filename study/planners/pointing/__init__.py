"""A 5-DOF robot points its drill anywhere in a cone: single directions and verified turns."""
