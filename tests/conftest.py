"""What every test runs under: no screen, no progress bars, the same hypothesis examples in every CI run."""

import os

from hypothesis import settings

from study.batch import ENVIRONMENT

os.environ.update({**ENVIRONMENT, "MPLBACKEND": "Agg"})

settings.register_profile("study", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("study")
