"""What every test runs under: no screen, no progress bars, the same hypothesis examples in every CI run."""

import os

import parallel
import pytest
from hypothesis import settings

from study.batch import ENVIRONMENT

os.environ.update({**ENVIRONMENT, "MPLBACKEND": "Agg"})

settings.register_profile("study", deadline=None, derandomize="CI" in os.environ)
settings.load_profile("study")


# Tests on several workers; plain pytest runs none of the three.


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes(config, specs):
    parallel.give_caches(config, specs)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    return parallel.scheduler(config, log)


def pytest_collection_modifyitems(config, items):
    if hasattr(config, "workerinput"):
        items.sort(key=parallel.turn)
