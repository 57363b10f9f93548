"""Unmilled bone as rows of bits and as a distance field."""
