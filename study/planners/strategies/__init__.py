"""Milling strategies: the 3-D planner and the 2.5-D zigzag (Siebold, 2.3 and 2.4.1)."""
