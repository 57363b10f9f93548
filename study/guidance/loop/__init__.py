"""The guided robot, tick by tick: what `study.guidance.drilling` runs."""
