"""How the burr moves: short paths, relocation, the way home (Siebold, 2.2.6, 2.3.4, 2.3.7)."""
