"""A robot with 4 degrees of freedom tilts its drill about one grid axis: windows of accessible angles."""
