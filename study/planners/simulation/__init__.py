"""State of the modified and unmodified simulations, kept in step (Siebold, 2.2)."""
