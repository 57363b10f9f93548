"""Compiled sweep of drawn transforms over lattice corners."""
