"""Milling planners: modified and unmodified simulation, fitness, strategies, the `Plan`."""
