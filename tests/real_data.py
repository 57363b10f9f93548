"""Where the real cases are; they are not part of the project, so tests that need them may be skipped."""

import os
from pathlib import Path

import pytest

REAL = Path(os.environ.get("STUDY_REAL_DATA", Path(__file__).resolve().parents[1] / ".." / "shared" / "real"))


def real(relative: str) -> Path:
    """The path of a real file or folder; skips the test when it is not there."""
    path = REAL / relative
    if not path.exists():
        pytest.skip(f"real data not present: {relative} (set STUDY_REAL_DATA)")
    return path
