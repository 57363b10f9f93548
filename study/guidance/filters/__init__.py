"""Filters of one signal: the patient's, and the low-pass that figure 7 compares with (Baron, 5.2 and 5.3)."""
