"""What the notebooks run over many bones and many draws, and what they claim of it: rows, tables, claims."""
