"""The profiles of ``params.yaml``: how much of everything a run takes."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import yaml

from study.errors import InputError
from study.paths import PROJECT

#: Names the profile of ``params.yaml`` that the pipeline runs in; ``quick`` when it is not set.
PROFILE_VARIABLE = "STUDY_PROFILE"


def chosen_profile() -> str:
    """Return the profile that the environment asks for.

    Raises
    ------
    InputError
        If ``params.yaml`` has no such profile.
    """
    profile = os.environ.get(PROFILE_VARIABLE) or "quick"
    profiles = yaml.safe_load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
    if profile not in profiles:
        raise InputError(f"{PROFILE_VARIABLE}={profile}: expected one of {', '.join(profiles)}")
    return profile


def profile_parameters(notebook: str, profile: str, file: Path = PROJECT / "params.yaml") -> dict[str, Any]:
    """Return what a profile sets for a notebook.

    Parameters
    ----------
    notebook : str
        Name of the notebook without folder and suffix.
    profile : str
        A top-level key of the file.
    file : pathlib.Path
        The file of profiles.

    Returns
    -------
    dict of str to object
        Parameters, empty if the profile says nothing about this notebook.

    Raises
    ------
    InputError
        If the file has no such profile.
    """
    profiles = yaml.safe_load(file.read_text(encoding="utf-8"))
    if profile not in profiles:
        raise InputError(f"{file.name} has no profile {profile!r}; it has: {', '.join(profiles)}")
    return dict(profiles[profile].get(notebook) or {})
