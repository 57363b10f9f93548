# make reproduce                 every table and figure that is here, in the quick profile
# make reproduce PROFILE=full    the same with all specimens and runs
# make test                      style, tests, every notebook
# make lab                       JupyterLab on the notebooks
# make clean                     removes the environment and everything generated

PYTHON  ?= python3
PROFILE ?= quick

VENV := .venv
BIN  := $(CURDIR)/$(VENV)/bin
MADE := $(VENV)/.made
# The pipeline's commands say `python`: that is the one of the environment.
RUN  := PATH="$(BIN):$$PATH" STUDY_PROFILE="$(PROFILE)" "$(BIN)/python" -m

.DEFAULT_GOAL := help
.PHONY: help reproduce test lab clean

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

reproduce: $(MADE)
	@$(RUN) study.reproduce
	@$(RUN) study.manifest

test: $(MADE)
	@$(RUN) ruff check --quiet
	@$(RUN) ruff format --check --quiet
	@$(RUN) pytest -n 2

lab: $(MADE)
	@$(RUN) jupyter lab notebooks

# An environment works only in the folder that it was made in, which it therefore remembers:
# with a copy of the project comes a new one.
ifneq ($(CURDIR),$(shell cat $(MADE) 2>/dev/null))
.PHONY: $(MADE)
endif

$(MADE): pyproject.toml constraints.txt
	@"$(PYTHON)" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	    echo "Python 3.11 or newer is needed, '$(PYTHON)' is not; choose one: make ... PYTHON=python3.12" >&2; \
	    exit 1; }
	@echo "Making the environment in $(VENV) (once, a few minutes)"
	@"$(PYTHON)" -m venv --clear $(VENV)
	@"$(BIN)/python" -m pip install -qq --disable-pip-version-check \
	    --constraint constraints.txt --editable '.[notebooks,test,viewer]'
	@echo "$(CURDIR)" > $@

clean:
	rm -rf $(VENV) .dvc/tmp .dvc/cache dvc.lock study.egg-info .pytest_cache .ruff_cache .hypothesis
	mkdir -p figures && find figures -mindepth 1 -not -path 'figures/readme*' -delete
	find study tests -name __pycache__ -type d -prune -exec rm -rf {} +
